#include "receiver/rates.h"

#include "common/limit.h"
#include "common/nf_math.h"
#include "storage/settings.h"

#define HALF_STICK_US 500u /* from the centre to an end */
#define THROTTLE_PER_US 0.001f
_Static_assert(NF_CHANNEL_MAX_US - NF_CHANNEL_MID_US == HALF_STICK_US, "of the upper half");
_Static_assert(NF_CHANNEL_MID_US - NF_CHANNEL_MIN_US == HALF_STICK_US, "of the lower half");
_Static_assert(NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US == 1000, "THROTTLE_PER_US says otherwise");

#define RATE_MAX (NF_RATE_MAX_DEG_S * NF_RAD_PER_DEG) /* rad/s */
_Static_assert(NF_RATE_MAX_DEG_S + NF_CALIBRATION_BIAS_DEG_S < (float)NF_GYRO_FULL_SCALE_DEG_S, "the gyro can say it");

static const struct stick {
	uint8_t channel;
	float sign; /* sign of the body rate for the upper half of the channel */
} sticks[3] = {
	{ NF_CHANNEL_ROLL, 1.0f },
	{ NF_CHANNEL_PITCH, 1.0f },
	{ NF_CHANNEL_YAW, -1.0f },
};

/* One axis of the settings, in their units. */
struct numbers {
	float rate, max, expo;
	uint32_t deadband_us;
};

static void rates_init_actual(struct rates_axis *axis, const struct numbers *numbers)
{
	const float rise = numbers->max - numbers->rate;

	axis->slope = numbers->rate * NF_RAD_PER_DEG;
	axis->rise = rise > 0.0f ? rise * NF_RAD_PER_DEG : 0.0f;
}

static void rates_init_betaflight(struct rates_axis *axis, const struct numbers *numbers)
{
	axis->slope = settings_rc_rate(numbers->rate) * (NF_RC_RATE_DEG_S * NF_RAD_PER_DEG);
	axis->rise = numbers->max;
}

/* The curves are odd functions: they map the stick's distance from the centre, 0..1, to a rate [rad/s], >= 0. */
static float rates_actual(const struct rates_axis *axis, float x)
{
	const float x2 = x * x;

	return x * axis->slope + axis->rise * (x * (x2 * x2 * x * axis->expo + x * (1.0f - axis->expo)));
}

static float rates_betaflight(const struct rates_axis *axis, float x)
{
	const float command = x * (x * x * x * axis->expo + (1.0f - axis->expo));

	return axis->slope * command / limit(1.0f - x * axis->rise, NF_SUPER_ROOM_MIN, 1.0f);
}

static const struct style {
	void (*init)(struct rates_axis *axis, const struct numbers *numbers);
	float (*curve)(const struct rates_axis *axis, float x);
} styles[] = {
	[NF_RATES_STYLE_ACTUAL] = { rates_init_actual, rates_actual },
	[NF_RATES_STYLE_BETAFLIGHT] = { rates_init_betaflight, rates_betaflight },
};

void rates_init(struct rates *rates, const struct nf_settings *settings)
{
	const struct nf_settings *s = settings;
	const struct numbers numbers[3] = {
		{ s->roll_rate, s->roll_max, s->roll_expo, s->deadband_us },
		{ s->pitch_rate, s->pitch_max, s->pitch_expo, s->deadband_us },
		{ s->yaw_rate, s->yaw_max, s->yaw_expo, s->yaw_deadband_us },
	};

	rates->style = s->rates_style;
	for (int i = 0; i < 3; ++i) {
		struct rates_axis *axis = &rates->axes[i];
		axis->deadband = (float)numbers[i].deadband_us;
		axis->per_us = 1.0f / (float)(HALF_STICK_US - numbers[i].deadband_us);
		axis->expo = numbers[i].expo;
		styles[rates->style].init(axis, &numbers[i]);
	}
}

void rates_setpoint(const struct rates *rates, const uint16_t channels_us[NF_CHANNEL_COUNT], float setpoint[3])
{
	for (int i = 0; i < 3; ++i) {
		const struct rates_axis *axis = &rates->axes[i];
		const int offset_us = channels_us[sticks[i].channel] - NF_CHANNEL_MID_US;
		const float way_us = (float)(offset_us < 0 ? -offset_us : offset_us) - axis->deadband;
		const float x = limit(way_us * axis->per_us, 0.0f, 1.0f);
		const float rate = limit(styles[rates->style].curve(axis, x), 0.0f, RATE_MAX);
		setpoint[i] = sticks[i].sign * (offset_us < 0 ? -rate : rate);
	}
}

float rates_throttle(const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	const float offset_us = (float)(channels_us[NF_CHANNEL_THROTTLE] - NF_CHANNEL_MIN_US);

	return limit(offset_us * THROTTLE_PER_US, 0.0f, 1.0f);
}
