/* The first layer of a recurrent network, by PyTorch's convention, of LANES samples at once: a GRU or an LSTM. */
#ifndef MEMORY_H
#define MEMORY_H

#include "dense.h"

/* GRU: h' = (1 - z) n + z h with r, z = logistic(of input + of state), n = tanh(of input + r of state).
 * LSTM: c' = f c + i g, h' = o tanh(c') with i, f, o = logistic(of input + of state), g = tanh(of input + of state). */
struct memory {
	int kind; /* MEMORY_GRU or MEMORY_LSTM */
	size_t units;
	struct dense input, state; /* units outputs for each gate: r, z, n; i, f, g, o */
	real *gates;               /* (T, 4 units): the gates; of a GRU also what the state gives to n */
	real *cells;               /* (T, units) of an LSTM: c' */
	real *nothing;             /* units rows of 0: state and cells before the first step */
	real *by_state;            /* units rows, from later steps */
	real *kept;                /* units rows: of an LSTM by the cells, from later steps; of a GRU what its layer gives back */
	real *sums;                /* rows of all gates, of input and state */
};

void memory_layout(struct memory *m, struct arena *a, int kind, size_t steps, size_t inputs, size_t units);
const real *memory_load(struct memory *m, const real *parameters);
real *memory_store(const struct memory *m, real *gradient);

/* before: the state of control step k - 1; NULL at the first. */
void memory_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after);

/* by_after: derivatives by the state after step k, without those through later steps, which are kept here. */
void memory_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x);

void gru_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after);
void gru_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x);
void lstm_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after);
void lstm_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x);

#endif
