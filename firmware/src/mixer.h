/* Mixer: the policy's motor fractions and the pilot's thrust to outputs, attitude first. */
#ifndef NF_MIXER_H
#define NF_MIXER_H

#include "nf_err.h"
#include "policy.h"

struct mixer {
	float idle; /* output at zero thrust, [0, 1) */
};

/* NF_ERR_IDLE for an idle outside [0, 1), NaN included. */
enum nf_err mixer_init(struct mixer *mixer, float idle);

/* The thrust rides on top as far as the largest action leaves room, so that no motor saturates and the
 * differences that turn the aircraft survive. action, throttle: 0..1. Writes fractions idle..1. */
void mixer_step(const struct mixer *mixer, const float action[POLICY_ACTION_COUNT], float throttle,
		float output[POLICY_ACTION_COUNT]);

#endif
