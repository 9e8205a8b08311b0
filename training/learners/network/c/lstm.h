/* A layer of long short-term memory, by PyTorch's convention, of LANES samples at once. */
#ifndef LSTM_H
#define LSTM_H

#include "dense.h"

/* c' = f c + i g, h' = o tanh(c') with i, f, o = logistic(of input + of state), g = tanh(of input + of state). */
struct lstm {
	size_t units;
	struct dense input, state; /* 4 units outputs each: i, f, g, o */
	real *gates;               /* (T, 4 units) */
	real *cells;               /* (T, units): c' */
	real *nothing;             /* units rows of 0: state and cells before the first step */
	real *by_state, *by_cell;  /* units rows, from later steps */
	real *sums;                /* 4 units rows, of input and state */
};

void lstm_layout(struct lstm *l, struct arena *a, size_t steps, size_t inputs, size_t units);
const real *lstm_load(struct lstm *l, const real *parameters);
void lstm_forward(const struct lstm *l, size_t k, const real *x, const real *before, real *after);
void lstm_backward(struct lstm *l, size_t k, const real *x, const real *before, const real *by_after, real *by_x);
real *lstm_store(const struct lstm *l, real *gradient);

#endif
