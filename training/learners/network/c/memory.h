/* The first layer of a recurrent network: a GRU or an LSTM. */
#ifndef MEMORY_H
#define MEMORY_H

#include "gru.h"
#include "lstm.h"

struct memory {
	int kind; /* MEMORY_GRU or MEMORY_LSTM */
	struct gru gru;
	struct lstm lstm;
};

void memory_layout(struct memory *m, struct arena *a, int kind, size_t steps, size_t inputs, size_t units);
const real *memory_load(struct memory *m, const real *parameters);
void memory_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after);
void memory_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x);
real *memory_store(const struct memory *m, real *gradient);

#endif
