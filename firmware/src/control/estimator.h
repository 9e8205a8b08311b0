/* Estimator: rotor speeds and rates that a model of the aircraft predicts, for policies that observe them.
 *
 * The rotors' equation runs on the outputs that were commanded, whichever controller flew; the rate is predicted from the
 * rotors and corrected by the gyro. The same law as sim/control/estimator.py. */
#pragma once

#include "nf_contract.h"
#include "policy.h"

/* Constants of the model for one control step, from the flown policy's blob. */
struct estimator_model {
	uint32_t delay;                          /* control steps from an output to the rotor; 0: there is no model */
	float curve[3];                          /* a, b, c: an output u settles at (a u + b) u + c [rad/s] */
	float rise, fall;                        /* share of the way there, gaining and losing speed */
	float gain_max, loss_max;                /* rad/s, most change */
	float correction;                        /* share of gyro less prediction that the prediction takes over */
	float turn[POLICY_ACTION_COUNT][3];      /* rad/s for a rotor's speed squared, by body axis */
	float reaction[POLICY_ACTION_COUNT][3];  /* rad/s for a rad/s that the rotor gained */
};

struct estimator {
	struct estimator_model model;
	float commands[NF_ESTIMATOR_DELAY_MAX + 1][POLICY_ACTION_COUNT]; /* a ring of model.delay + 1 steps */
	uint32_t oldest;                     /* of them */
	bool measures;                       /* the rotors are the measured ones, as far as ESCs tell */
	float speed[POLICY_ACTION_COUNT];    /* rad/s */
	float gained[POLICY_ACTION_COUNT];   /* rad/s, in this control step; known once it has begun */
	float rotor[POLICY_ACTION_COUNT];    /* rad/s, speed less that at rest under the throttle */
	float rate[3];                       /* rad/s, body */
	float error[3]; /* rad/s, setpoint less that */
};

/* `header`: of the flown policy's blob, checked; NULL, or without a model: its delay is 0, and nothing below is to be
 * called but the reset. */
void estimator_init(struct estimator *estimator, const struct nf_policy_blob_header *header);

/* Rotors stand still, and nothing was commanded. */
void estimator_reset(struct estimator *estimator);

/* A control step begins: the rotors go on by one, or to the speeds that are measured [rad/s]. silent: bit field of motors without
 * one. */
void estimator_advance(struct estimator *estimator, const float measured[POLICY_ACTION_COUNT], uint32_t silent);

/* Then, where the policy flies: fills in `rotor`, `rate` and `error`.
 *
 * gyro, setpoint: [rad/s], body. rest: the output of motors under this step's throttle alone. first: the rate begins with
 * the gyro's. held: by the ground: its rotors turn nothing. */
void estimator_observe(struct estimator *estimator, const float gyro[3], const float setpoint[3], float rest,
		       bool first, bool held);

/* The step ends with these outputs; `standing`: the motors stand still instead. */
void estimator_command(struct estimator *estimator, const float output[POLICY_ACTION_COUNT], bool standing);
