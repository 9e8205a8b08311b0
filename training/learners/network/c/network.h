/* The policy network of LANES samples at once: forward for every control step, then backward from the last. */
#ifndef NETWORK_H
#define NETWORK_H

#include "dense.h"
#include "memory.h"

struct layers {
	const struct network *network;
	struct memory memory;            /* instead of the first layer of a recurrent network */
	struct dense dense[LAYERS_MAX];
	size_t stored[LAYERS_MAX];       /* rows of a hidden layer's outputs at a control step */
	real *hidden[LAYERS_MAX];        /* (T, stored) */
	real *by_sum, *by_hidden;        /* rows, as many as the widest layer's */
};

void layers_layout(struct layers *n, struct arena *a, const struct network *network, size_t steps);
void layers_load(struct layers *n, const real *parameters);
void layers_forward(const struct layers *n, size_t k, const real *x, real *unclipped);
void layers_backward(struct layers *n, size_t k, const real *x, const real *by_unclipped, real *by_x);
void layers_squash(int activation, real *values, size_t count);
void layers_unsquash(int activation, const real *values, const real *by_value, real *by_sum, size_t count);
void layers_store(const struct layers *n, real *gradient);

#endif
