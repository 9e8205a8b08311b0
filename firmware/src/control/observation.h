/* Observation: the policy's input, made of terms: named blocks (toolchain/contract/), each optionally low-passed,
 * then optionally delayed by some steps. */
#pragma once

#include "common/held.h"
#include "nf_contract.h"

/* Input of a control step. */
struct observation_input {
	const float *rate;            /* [3] rad/s, body */
	const float *setpoint;        /* [3] rad/s, body */
	const float *previous_action; /* [motor_count], the policy's last output; zeros on the first step */
	float throttle;               /* 0..1 */
	const float *rotor_speed;     /* [motor_count] rad/s; used only by terms that need it */
	const float *previous_motors; /* [motor_count], the last fractions before the idle, less the throttle */
	/* Outputs of the estimator; used only by terms that need them. */
	const float *rotor_estimate; /* [motor_count] rad/s */
	const float *rate_estimate; /* [3] rad/s */
	const float *rate_estimate_error; /* [3] rad/s */
	bool standing; /* on the ground: the integral does not grow */
};

/* The terms in the policy's order, `count` of each. */
struct observation_terms {
	const unsigned char *blocks; /* codes of enum nf_observation */
	const unsigned char *ages;   /* control steps, at most NF_OBSERVATION_AGE_MAX */
	const float *gains;          /* a of the low-pass y += a (x - y), [0, 1); 0: none */
	size_t count;                /* at most NF_OBSERVATION_TERMS_MAX */
};

struct observation {
	HELD(const unsigned char *, blocks); /* of the terms, as all of these */
	HELD(const unsigned char *, ages);
	HELD(const float *, gains);
	uint32_t count;
	uint32_t motor_count;
	float period_s;              /* control period */
	bool first;                  /* no step since the reset */
	float error[3];              /* rad/s, setpoint - rate of the last step */
	float delta[3];              /* rad/s, error - that of the step before; 0 on the first step */
	float integral[3];           /* rad, sum of error times period, the present step's included; clamped */
	/* Term by term: the low-pass's y, then the values of the last `age` steps, the oldest at turns[term]. */
	float memory[NF_OBSERVATION_MEMORY_MAX];
	unsigned char turns[NF_OBSERVATION_TERMS_MAX];
};

/* Is the block among the terms? */
bool observation_sees(const struct observation *o, enum nf_observation block);

/* The arrays of `terms` must outlive the observation. NF_ERR_OBSERVATION for an unknown code (a block that this
 * core has no source for, say), an age, gain or count beyond the bounds above, terms that would remember more
 * than NF_OBSERVATION_MEMORY_MAX floats, or a width (the sum of the blocks') other than `width`. */
enum nf_err observation_init(struct observation *o, const struct observation_terms *terms, size_t motor_count,
			     size_t width, unsigned control_rate_hz);

/* Clears the state: the next step is the first. */
void observation_reset(struct observation *o);

/* One control step: writes `width` values. */
void observation_step(struct observation *o, const struct observation_input *input, float out[]);
