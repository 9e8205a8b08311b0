#include "mixer.h"

#include "limit.h"

enum nf_err mixer_init(struct mixer *mixer, float idle)
{
	if (!(idle >= 0.0f && idle < 1.0f))
		return NF_ERR_IDLE;
	mixer->idle = idle;
	return NF_OK;
}

void mixer_step(const struct mixer *mixer, const float action[POLICY_ACTION_COUNT], float throttle,
		float output[POLICY_ACTION_COUNT])
{
	float largest = action[0];
	for (int i = 1; i < POLICY_ACTION_COUNT; i++)
		largest = action[i] > largest ? action[i] : largest;

	const float thrust = throttle * (1.0f - largest);
	for (int i = 0; i < POLICY_ACTION_COUNT; i++) {
		/* Rounding may carry the sum a hair past 1. */
		const float mixed = limit(thrust + action[i], 0.0f, 1.0f);
		output[i] = mixer->idle + (1.0f - mixer->idle) * mixed;
	}
}
