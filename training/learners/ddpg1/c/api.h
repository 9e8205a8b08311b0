/* What Python calls and fills in. Read by the C compiler and by cffi.
 *
 * Arrays belong to Python and outlive the structs that point to them. n is the number of observed values, M that of motors, N
 * that of aircraft. `real` is float for training and double for tests. */

#ifndef DDPG1_API_H
#define DDPG1_API_H

#include "network/c/api.h"

enum { DDPG1_FIGURES = 2 };

/* The critic: its first hidden layer sees the observation, the rest sees that layer's values and then the action. */
struct critic {
	uint32_t inputs, units; /* of the first hidden layer */
	struct network rest;    /* of units + M inputs */
};

/* Updates: each takes a minibatch, a step of Adam for the actor and one for the critic, and moves the targets. */
struct updates {
	struct network actor; /* ends in tanh */
	struct critic critic;
	uint32_t count, minibatch;
	const int32_t *drawn;     /* (count, minibatch) rows */
	struct observed observed; /* rows of `stride` numbers: observation (n), action (M), reward, next observation (n) */
	real discount, tau;
	real decay;               /* weight of the critic's squared weights, halved, in its loss; the last layer has none */
	/* Actor, then critic: */
	real *parameters, *targets;
	real *gradient;           /* the last one */
	struct adam adam[2];      /* of the actor and of the critic */
	double *figures;          /* (DDPG1_FIGURES): means of the critic's squared error and of the actor's value */
};

/* Memory [numbers] for `ddpg1_update` and `ddpg1_values` with these networks. */
size_t ddpg1_memory(const struct network *actor, const struct critic *critic);

void ddpg1_update(const struct updates *u, real *memory);

/* The critic's values (count) of rows as `updates` has them. */
void ddpg1_values(const struct critic *critic, const real *parameters, uint32_t count, const struct observed *observed,
		  real *values, real *memory);

/* Outputs (N, M) of actors that differ: `parameters` (parameters of an actor, N). The memory has 2 N times the widest layer. */
void ddpg1_act(const struct network *actor, const real *parameters, uint32_t count, const struct observed *observed,
	       real *outputs, real *memory);

#endif
