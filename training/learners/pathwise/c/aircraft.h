/* What the aircraft of a block do in a sample, forward and backward. */
#ifndef AIRCRAFT_H
#define AIRCRAFT_H

#include "api.h"
#include "network/c/lanes.h"

/* ---- body.c: turns about its centre of mass ---- */

void body_turn(const struct plan *p, const real *moment, const real *rate, real *after);
void body_turn_back(const struct plan *p, const real *moment, const real *rate, const real *by_after, real *by_moment,
		    real *by_rate);

/* ---- rotor.c: speeds and moments of rotors, by the equations of sim/physics/c/rotor.c ---- */

/* A sample of a block, rows. */
struct turning {
	const real *before, *after; /* (M) [rad/s] */
	const real *acting;         /* (M), commands */
	real *gained;               /* (M) [rad/s], after less before; to more digits where rotors_turn found it */
	const real *ratio;          /* of the supply's voltage to the bench's; NULL: 1 */
};

/* Derivatives of the loss, rows. */
struct by_turning {
	real *before, *after; /* (M) [s/rad] */
	real *acting;         /* (M) */
};

void rotors_turn(const struct plan *p, const struct block *b, const struct turning *t, real *after);
void rotors_turn_back(const struct plan *p, const struct block *b, const struct turning *t, struct by_turning *by);
void rotors_moment(const struct plan *p, const struct block *b, const struct turning *t, const real *rate, real *moment);
void rotors_moment_back(const struct plan *p, const struct block *b, const struct turning *t, const real *rate,
			const real *by_moment, struct by_turning *by, real *by_rate);
void rotor_loads(const struct propulsion *p, const real *speed, real *thrust, real *ratio);

/* ---- supply.c: batteries, by the equations of sim/physics/c/battery.c and supply.c ---- */

struct supply {
	real used[LANES]; /* [A s] */
};

void supply_begin(struct supply *s, const struct plan *p, const struct block *b, real *ratio);
void supply_step(struct supply *s, const struct plan *p, const struct block *b, const struct turning *t, real *ratio);

/* ---- gyro.c: sim/physics/c/sensor.c, and the mean of a control step's samples ---- */

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
