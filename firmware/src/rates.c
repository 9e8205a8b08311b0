#include "rates.h"

#include "limit.h"

#define STICK_PER_US 0.002f /* +-1 over +-500 us */
#define THROTTLE_PER_US 0.001f
#define FULL_STICK 17.453292519943297f /* rad/s: 1000 deg/s */
_Static_assert(NF_CHANNEL_MAX_US - NF_CHANNEL_MID_US == 500, "STICK_PER_US says otherwise");
_Static_assert(NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US == 1000, "THROTTLE_PER_US says otherwise");
_Static_assert(NF_RATE_FULL_STICK_DEG_S == 1000, "FULL_STICK says otherwise");

static const struct axis {
	int channel;
	float full_stick; /* rad/s */
} axes[3] = {
	{ NF_CHANNEL_ROLL, FULL_STICK },
	{ NF_CHANNEL_PITCH, FULL_STICK },
	{ NF_CHANNEL_YAW, -FULL_STICK },
};

void rates_setpoint(const uint16_t channels_us[NF_CHANNEL_COUNT], float setpoint[3])
{
	for (int i = 0; i < 3; i++) {
		const float offset_us = (float)(channels_us[axes[i].channel] - NF_CHANNEL_MID_US);
		setpoint[i] = limit(offset_us * STICK_PER_US, -1.0f, 1.0f) * axes[i].full_stick;
	}
}

float rates_throttle(const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	const float offset_us = (float)(channels_us[NF_CHANNEL_THROTTLE] - NF_CHANNEL_MIN_US);

	return limit(offset_us * THROTTLE_PER_US, 0.0f, 1.0f);
}
