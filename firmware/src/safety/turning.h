/* Turning: how fast each axis changes its rate, for those who ask whether it turns towards its setpoint. */
#pragma once

#include "nf_contract.h"

/* Two low-passes in a row follow a rate that changes steadily at a distance which tells how fast it does. */
struct turning {
	bool started;              /* a rate came since the reset */
	float near_gain, far_gain; /* part of the way that a low-pass goes in a control step */
	float near[3], far[3];     /* rad/s */
};

void turning_init(struct turning *turning, unsigned control_rate_hz);

/* A flight begins. */
void turning_reset(struct turning *turning);

/* One control step. rate: rad/s, body axes. */
void turning_step(struct turning *turning, const float rate[3]);

/* Does the rate of `axis` change by more than NF_TURNING_DEG_S2 towards a setpoint that is `error` away? */
bool turning_towards(const struct turning *turning, int axis, float error);

/* Does an axis already turn the way that its setpoint asks, only not as fast? An aircraft that is not turning towards its
 * setpoint any more has then reached what it can. */
bool turning_at_limit(float rate, float error);
