/* A layer of gated recurrent units, by PyTorch's convention, of LANES samples at once. */
#ifndef GRU_H
#define GRU_H

#include "dense.h"

/* h' = (1 - z) n + z h with r, z = logistic(of input + of state), n = tanh(of input + r of state). */
struct gru {
	size_t units;
	struct dense input, state; /* 3 units outputs each: r, z, n */
	real *gates;               /* (T, 4 units): r, z, n and what the state gives to n */
	real *nothing;             /* units rows of 0: the state before the first step */
	real *by_state, *kept;     /* units rows, from later steps */
	real *sums;                /* 3 units rows, of input and state */
};

void gru_layout(struct gru *g, struct arena *a, size_t steps, size_t inputs, size_t units);
const real *gru_load(struct gru *g, const real *parameters);
void gru_forward(const struct gru *g, size_t k, const real *x, const real *before, real *after);
void gru_backward(struct gru *g, size_t k, const real *x, const real *before, const real *by_after, real *by_x);
real *gru_store(const struct gru *g, real *gradient);

#endif
