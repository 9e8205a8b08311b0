/* Mixer: the controller's motor fractions and the pilot's thrust to outputs, attitude first. */
#ifndef NF_MIXER_H
#define NF_MIXER_H

#include <stdbool.h>

#include "common/nf_err.h"
#include "nf_contract.h"
#include "policy.h"

struct mixer {
	float idle;        /* output at zero thrust, [0, limit] */
	float span;        /* from there to the limit */
	float limit;       /* largest output, (0, 1] */
	bool motor_stop;
};

/* `settings` within their limits; what is needed of them is copied. NF_ERR_IDLE as mixer_set_idle. */
enum nf_err mixer_init(struct mixer *mixer, const struct nf_settings *settings, float idle);

/* The idle of the controller that flies from now on. A limit below it prevails: all motors then turn at the limit.
 * NF_ERR_IDLE for an idle outside [0, 1), NaN included, and the last one stays. */
enum nf_err mixer_set_idle(struct mixer *mixer, float idle);

/* The thrust is added as far as the largest action leaves room, so that no motor saturates and the differences between
 * the motors, which turn the aircraft, are kept. action, throttle: 0..1. Writes fractions idle..limit. */
void mixer_step(const struct mixer *mixer, const float action[POLICY_ACTION_COUNT], float throttle,
		float output[POLICY_ACTION_COUNT]);

/* Is the thrust (0..1) so low that armed motors are to stand still? Only if the pilot set motor_stop. */
bool mixer_stops(const struct mixer *mixer, float throttle);

#endif
