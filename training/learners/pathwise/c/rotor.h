/* Rotors of a block: speeds and moments over a sample, and their derivatives. The equations are those of the twin, see
 * sim/physics/c/rotor.c. */
#ifndef ROTOR_H
#define ROTOR_H

#include "api.h"
#include "network/c/lanes.h"

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

#endif
