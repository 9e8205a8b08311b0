/* Observation: the policy's input, put together from named blocks (toolchain/contract.py). */
#ifndef NF_OBSERVATION_H
#define NF_OBSERVATION_H

#include <stdbool.h>
#include <stddef.h>

#include "nf_contract.h"
#include "nf_err.h"

/* What a control step knows before the policy runs. */
struct observation_input {
	const float *rate;            /* [3] rad/s, body */
	const float *setpoint;        /* [3] rad/s, body */
	const float *previous_action; /* [motor_count], the policy's last output; zeros on the first step */
	float throttle;               /* 0..1 */
};

struct observation {
	const unsigned char *blocks; /* codes of enum nf_observation, in the policy's order */
	size_t block_count;
	size_t motor_count;
	float period_s;              /* control period */
	bool first;                  /* no step since the reset */
	float error[3];              /* rad/s, setpoint - rate of the last step */
	float delta[3];              /* rad/s, error - that of the step before; 0 on the first step */
	float integral[3];           /* rad, sum of error times period, the present step's included; clamped */
};

/* `blocks` must outlive the observation. NF_ERR_OBSERVATION for an unknown code or a width (the sum of the
 * blocks') other than `width`. */
enum nf_err observation_init(struct observation *o, const unsigned char *blocks, size_t block_count,
			     size_t motor_count, size_t width, unsigned control_rate_hz);

/* Forgets the past: the next step is the first. */
void observation_reset(struct observation *o);

/* One control step: writes `width` values. */
void observation_step(struct observation *o, const struct observation_input *input, float out[]);

#endif
