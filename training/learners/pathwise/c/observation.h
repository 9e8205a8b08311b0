/* The policy's input as sim/control/observation.py makes it, and its derivatives. */
#ifndef OBSERVATION_H
#define OBSERVATION_H

#include "tape.h"

/* The contract's codes. */
enum {
	BLOCK_RATE = 1,
	BLOCK_ERROR,
	BLOCK_ERROR_DELTA,
	BLOCK_ERROR_INTEGRAL,
	BLOCK_PREVIOUS_ACTION,
	BLOCK_THROTTLE,
	BLOCK_ROTOR_SPEED,
	BLOCK_GRAVITY,
	BLOCK_PREVIOUS_MOTORS,
	BLOCK_ROTOR_ESTIMATE,
	BLOCK_RATE_ESTIMATE,
	BLOCK_RATE_ESTIMATE_ERROR,
	BLOCKS,
};

/* Rows of each block at a control step; or derivatives of the loss by them. */
struct sensed {
	real of[BLOCKS][MOTORS_MAX * LANES];
};

/* What is kept between control steps. */
struct observer {
	real error[3 * LANES], integral[3 * LANES];
};

void observe_error(struct observer *o, const struct controller *c, size_t k, const real *setpoint, struct sensed *s,
		   real *free);
void observe_error_back(struct observer *by, const struct controller *c, size_t k, const real *free, struct sensed *by_s,
			real *by_gyro);
void observe_terms(const struct controller *c, const struct tape *t, size_t k, const struct sensed *s);
void observe_terms_back(const struct controller *c, const struct tape *t, size_t k, struct sensed *by);
const real *observed(const struct controller *c, const struct tape *t, size_t k);

#endif
