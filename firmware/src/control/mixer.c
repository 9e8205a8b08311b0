#include "control/mixer.h"

#include "common/limit.h"

/* The thrust of the highest throttle stick that arms. */
#define THROTTLE_LOW ((float)(NF_THROTTLE_LOW_US - NF_CHANNEL_MIN_US) / (float)(NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US))

_Static_assert(POLICY_ACTION_COUNT <= NF_MOTOR_COUNT_MAX, "too many motors");

enum nf_err mixer_init(struct mixer *mixer, const struct nf_settings *settings, float idle, enum nf_mix mix)
{
	mixer->mix = mix;
	mixer->raised = 0.0f;
	mixer->limit = settings->motor_limit;
	mixer->motor_stop = settings->motor_stop != 0;
	return mixer_set_idle(mixer, idle);
}

enum nf_err mixer_set_idle(struct mixer *mixer, float idle)
{
	if (!(idle >= 0.0f && idle < 1.0f))
		return NF_ERR_IDLE;
	mixer->idle = idle < mixer->limit ? idle : mixer->limit;
	mixer->span = mixer->limit - mixer->idle;
	return NF_OK;
}

static void mixer_put_attitude_first(const float action[POLICY_ACTION_COUNT], float throttle,
				     float mixed[POLICY_ACTION_COUNT])
{
	float largest = action[0];
	for (int i = 1; i < POLICY_ACTION_COUNT; ++i)
		largest = action[i] > largest ? action[i] : largest;

	const float thrust = throttle * (1.0f - largest);
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		mixed[i] = thrust + action[i];
}

static void mixer_centre(const float action[POLICY_ACTION_COUNT], float throttle, float mixed[POLICY_ACTION_COUNT])
{
	float sum = action[0];
	for (int i = 1; i < POLICY_ACTION_COUNT; ++i)
		sum += action[i];

	const float mean = sum / (float)POLICY_ACTION_COUNT;
	float low = throttle + (action[0] - mean), high = low;
	mixed[0] = low;
	for (int i = 1; i < POLICY_ACTION_COUNT; ++i) {
		const float raw = throttle + (action[i] - mean);
		low = raw < low ? raw : low;
		high = raw > high ? raw : high;
		mixed[i] = raw;
	}
	const float above = high > 1.0f ? 1.0f - high : 0.0f;
	const float shift = low < 0.0f ? -low : above;
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		mixed[i] += shift;
}

void mixer_mix(const struct mixer *mixer, const float action[POLICY_ACTION_COUNT], float throttle,
	       float mixed[POLICY_ACTION_COUNT])
{
	if (mixer->mix == NF_MIX_CENTRED)
		mixer_centre(action, throttle, mixed);
	else
		mixer_put_attitude_first(action, throttle, mixed);
	/* Rounding may leave 0..1 by a little. */
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		mixed[i] = limit(mixed[i], 0.0f, 1.0f);
}

float mixer_rest(const struct mixer *mixer, float throttle)
{
	return mixer->idle + mixer->raised + (mixer->span - mixer->raised) * throttle;
}

void mixer_raise(const struct mixer *mixer, const float mixed[POLICY_ACTION_COUNT], float output[POLICY_ACTION_COUNT])
{
	const float idle = mixer->idle + mixer->raised, span = mixer->span - mixer->raised;

	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		output[i] = idle + span * mixed[i];
}

void mixer_raise_idle(struct mixer *mixer, float by)
{
	mixer->raised = by < mixer->span ? by : mixer->span;
}

bool mixer_stops(const struct mixer *mixer, float throttle)
{
	return mixer->motor_stop && throttle <= THROTTLE_LOW;
}
