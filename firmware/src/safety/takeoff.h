/* Take-off: has the aircraft left the ground since it was armed?
 *
 * Once airborne it is so until the next arming: with a closed throttle, one that has landed and one that hovers on its idle
 * are the same to gyro and accelerometer. */
#pragma once

#include "nf_contract.h"

struct takeoff {
	bool airborne;
	uint32_t raised_after; /* control steps above NF_TAKEOFF_THROTTLE that are a take-off; 0: arming is one */
	uint32_t raised;       /* of them in a row, so far */
	float period_s;        /* of a control step */
	float kept;            /* part of a turn that is left of it after a control step */
	float turned[3];       /* rad, about each body axis lately */
};

void takeoff_init(struct takeoff *takeoff, const struct nf_settings *settings, unsigned control_rate_hz);

/* The motors have stopped. */
void takeoff_reset(struct takeoff *takeoff);

/* One control step with motors that may turn, until it is airborne. rate: [rad/s], body axes; throttle: 0..1. */
void takeoff_step(struct takeoff *takeoff, const float rate[3], float throttle);
