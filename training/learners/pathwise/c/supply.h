/* Batteries of a block; the equations are those of sim/physics/c/battery.c and supply.c. */
#ifndef SUPPLY_H
#define SUPPLY_H

#include "rotor.h"

struct supply {
	real used[LANES]; /* [A s] */
};

void supply_begin(struct supply *s, const struct plan *p, const struct block *b, real *ratio);
void supply_step(struct supply *s, const struct plan *p, const struct block *b, const struct turning *t, real *ratio);

#endif
