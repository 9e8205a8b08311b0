#include "control/mixer.h"

#include "common/limit.h"

/* The thrust of the highest throttle stick that arms. */
#define THROTTLE_LOW ((float)(NF_THROTTLE_LOW_US - NF_CHANNEL_MIN_US) / (float)(NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US))

_Static_assert(POLICY_ACTION_COUNT <= NF_MOTOR_COUNT_MAX, "too many motors");

enum nf_err mixer_init(struct mixer *mixer, const struct nf_settings *settings, float idle)
{
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

void mixer_step(const struct mixer *mixer, const float action[POLICY_ACTION_COUNT], float throttle,
		float output[POLICY_ACTION_COUNT])
{
	float largest = action[0];
	for (int i = 1; i < POLICY_ACTION_COUNT; ++i)
		largest = action[i] > largest ? action[i] : largest;

	const float thrust = throttle * (1.0f - largest);
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		/* Rounding may make the sum slightly larger than 1. */
		const float mixed = limit(thrust + action[i], 0.0f, 1.0f);
		output[i] = mixer->idle + mixer->span * mixed;
	}
}

bool mixer_stops(const struct mixer *mixer, float throttle)
{
	return mixer->motor_stop && throttle <= THROTTLE_LOW;
}
