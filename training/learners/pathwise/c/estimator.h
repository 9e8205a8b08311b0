/* Rotor speeds and rates that a model of the aircraft predicts; sim/control/estimator.py. */
#ifndef ESTIMATOR_H
#define ESTIMATOR_H

#include "observation.h"

/* Kept between control steps: predicted rates, rows (3); or derivatives by them and by the modelled rotor speeds. */
struct estimates {
	real rate[3 * LANES];
	real rotor_speed[MOTORS_MAX * LANES];
};

void estimate(struct estimates *e, const struct plan *p, const struct tape *t, size_t k, const real *setpoint,
	      const real *throttle, struct sensed *s);
void estimate_back(struct estimates *by, const struct plan *p, const struct tape *t, size_t k, const struct sensed *by_s,
		   real *by_gyro);

#endif
