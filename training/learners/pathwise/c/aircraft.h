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
void rotors_told(const struct plan *p, const real *speed, real *restrict told);
void rotor_loads(const struct propulsion *p, const real *speed, real *thrust, real *ratio);

/* ---- supply.c: batteries, by the equations of sim/physics/c/battery.c and supply.c ---- */

struct supply {
	real used[LANES]; /* [A s] */
};

void supply_begin(struct supply *s, const struct plan *p, const struct block *b, real *ratio);
void supply_step(struct supply *s, const struct plan *p, const struct block *b, const struct turning *t, real *ratio);

/* ---- notches.c ---- */

/* Going back, `band` and `low` are derivatives of the loss by them. */
struct notches {
	real told[MOTORS_MAX * LANES]; /* [rad/s], rotor speeds as ESCs tell them */
	real gain[MOTORS_MAX * NOTCHES_MAX * LANES], depth[MOTORS_MAX * NOTCHES_MAX * LANES];
	real band[3 * MOTORS_MAX * NOTCHES_MAX * LANES], low[3 * MOTORS_MAX * NOTCHES_MAX * LANES];
	real *kept; /* (N, 2 harmonics), gain and depth that each sample has moved; NULL: not kept */
};

void notches_begin(struct notches *f, const struct plan *p, real *kept);
void notches_sample(struct notches *f, const struct plan *p, size_t n, real *reading);
void notches_end(struct notches *f, const struct plan *p, size_t last, real *kept);
void notches_back(struct notches *f, const struct plan *p, size_t n, real *by);

/* ---- gyro.c: sim/physics/c/sensor.c, notches, and the mean of a control step's last samples ---- */

/* sin of an angle in turns, to 1e-7. */
static inline real sine_of(real turns)
{
	const real within = turns - real_rint(turns);
	const real folded = within > R(0.25) ? R(0.5) - within : within < R(-0.25) ? R(-0.5) - within : within;
	const real x = folded * R(6.283185307179586), square = x * x;
	real sum = R(-2.505210838544172e-8);

	sum = real_fma(sum, square, R(2.755731922398589e-6));
	sum = real_fma(sum, square, R(-1.984126984126984e-4));
	sum = real_fma(sum, square, R(8.333333333333333e-3));
	sum = real_fma(sum, square, R(-0.16666666666666666));
	return real_fma(sum * square, x, x);
}

struct gyros {
	real lagged[3 * LANES];           /* [rad/s] */
	real phase[MOTORS_MAX * LANES];   /* turns of the rotors, -0.5 to 0.5 */
	struct notches notches;
	real sum[3 * LANES];              /* of the readings since the control step before */
};

/* kept: see notches_begin. */
void gyro_begin(struct gyros *g, const struct plan *p, const struct block *b, const real *rate, real *kept);
void gyro_sample(struct gyros *g, const struct plan *p, const struct block *b, size_t sample, const struct turning *t,
		 const real *rate);
void gyro_mean(struct gyros *g, const struct plan *p, real *mean);

/* Derivatives of the loss, from the last sample to the first. */
struct by_gyros {
	real by_mean[3 * LANES];   /* by each of the readings of a control step's mean */
	struct notches notches;    /* of the flight, behind notches_end */
	real by_lagged[3 * LANES]; /* from later samples */
};

void gyro_sample_back(struct by_gyros *g, const struct plan *p, size_t sample, real *by_rate);

#endif
