/* Mixer: the controller's motor fractions and the pilot's thrust to outputs, as the controller's mix says (enum nf_mix). */
#pragma once

#include "nf_contract.h"
#include "policy.h"

struct mixer {
	float idle; /* output at zero thrust, [0, limit] */
	float span; /* from there to the limit */
	float raised; /* of the idle, for now */
	float limit; /* largest output, (0, 1] */
	bool motor_stop;
	enum nf_mix mix;
};

/* `settings` within their limits; what is needed of them is copied. mix: of the controller. NF_ERR_IDLE as
 * mixer_set_idle. */
enum nf_err mixer_init(struct mixer *mixer, const struct nf_settings *settings, float idle, enum nf_mix mix);

/* The idle of the controller that flies from now on. A limit below it prevails: all motors then turn at the limit.
 * NF_ERR_IDLE for an idle outside [0, 1), NaN included, and the last one stays. */
enum nf_err mixer_set_idle(struct mixer *mixer, float idle);

/* Writes the motors' fractions 0..1, before the idle, of action and throttle, 0..1 each. No motor saturates, so that the
 * differences between the motors, which turn the aircraft, are kept.
 *
 * Attitude first: the thrust is added as far as the largest action leaves room. Centred: the actions' mean gives way to the
 * throttle, and all motors are raised until none is below 0, or lowered until none is above 1. */
void mixer_mix(const struct mixer *mixer, const float action[POLICY_ACTION_COUNT], float throttle,
	       float mixed[POLICY_ACTION_COUNT]);

/* Raises the idle by so much [output, 0 or more] until the next call, at most to the limit. */
void mixer_raise_idle(struct mixer *mixer, float by);

/* Outputs, idle..limit, of fractions 0..1 before the idle. */
void mixer_raise(const struct mixer *mixer, const float mixed[POLICY_ACTION_COUNT], float output[POLICY_ACTION_COUNT]);

/* The output of a motor that turns nothing: of this throttle alone. */
float mixer_rest(const struct mixer *mixer, float throttle);

/* Is the thrust (0..1) so low that armed motors are to stand still? Only if the pilot set motor_stop. */
bool mixer_stops(const struct mixer *mixer, float throttle);
