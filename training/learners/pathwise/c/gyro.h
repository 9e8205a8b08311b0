/* The gyros of a block, sample by sample, and the mean of a control step's samples; sim/physics/c/sensor.c. */
#ifndef GYRO_H
#define GYRO_H

#include "rotor.h"

struct gyros {
	real lagged[3 * LANES];           /* [rad/s] */
	real phase[MOTORS_MAX * LANES];   /* turns of the rotors, -0.5 to 0.5 */
	real sum[3 * LANES];              /* of the readings since the control step before */
};

void gyro_begin(struct gyros *g, const struct plan *p, const struct block *b, const real *rate);
void gyro_sample(struct gyros *g, const struct plan *p, const struct block *b, size_t sample, const struct turning *t,
		 const real *rate);
void gyro_mean(struct gyros *g, const struct plan *p, real *mean);

/* Derivatives of the loss, from the last sample to the first. */
struct by_gyros {
	real by_mean[3 * LANES];   /* by each of the readings of a control step */
	real by_lagged[3 * LANES]; /* from later samples */
};

void gyro_sample_back(struct by_gyros *g, const struct plan *p, bool first, real *by_rate);

#endif
