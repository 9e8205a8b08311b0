/* A layer y = W x + b of LANES samples at once, and its derivatives. */
#ifndef DENSE_H
#define DENSE_H

#include "lanes.h"

enum { TILE = 4, PART = 8 };

/* Rows of outputs are padded to TILE, rows of inputs to PART. */
struct dense {
	size_t inputs, outputs;
	real *forward, *bias;    /* W and b by tiles of outputs */
	real *backward;          /* W by tiles of inputs */
	real *by_weight;         /* sums of the gradient, (outputs, inputs) padded to TILE and LANES */
	real *by_bias;           /* rows */
	real *turned;            /* LANES inputs, one after the other */
};

void dense_layout(struct dense *d, struct arena *a, size_t inputs, size_t outputs);
const real *dense_load(struct dense *d, const real *parameters);
void dense_forward(const struct dense *d, const real *x, real *y);
void dense_backward(const struct dense *d, const real *by_y, real *by_x);
void dense_gather(struct dense *d, const real *by_y, const real *x);
real *dense_store(const struct dense *d, real *gradient);

#endif
