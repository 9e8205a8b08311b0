/* A policy's or a critic's network, as Python describes it. Read by the C compiler and by cffi.
 *
 * Networks compute LANES samples side by side. A row holds a number of each of them, lane by lane; an array of shape (T, 3)
 * here is T times 3 rows. `real` is float for training and double for tests. */

#ifndef NETWORK_API_H
#define NETWORK_API_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef FLOAT64
#include "float64/api.h"
#else
#include "float32/api.h"
#endif

enum {
	LANES = 16,
	LAYERS_MAX = 9, /* with the last */
};

enum { ACTIVATION_RELU, ACTIVATION_TANH };

enum { MEMORY_NONE, MEMORY_GRU, MEMORY_LSTM };

struct network {
	uint32_t layers;               /* the hidden ones and the last */
	uint32_t width[LAYERS_MAX + 1]; /* observation, hidden layers, motors */
	int memory;                    /* of the first hidden layer */
	int activation;
	real scale, offset; /* output to motor fraction */
	bool squash;
};

/* Samples' observations of n values each, and what normalizes them: (x - mean) times factor. */
struct observed {
	const real *values;
	size_t stride;             /* numbers from a sample's observation to the next one's */
	const real *mean, *factor; /* (n) */
};

/* Adam, with the two means that it keeps for each parameter. */
struct adam {
	real rate, eps;
	double decay[2];
	uint64_t updates;     /* so far */
	real *first, *second; /* means of the gradient and of its square */
};

/* Memory [numbers] for `network_outputs`. */
size_t network_memory(const struct network *network);

/* Outputs (count, outputs) for normalized observations. `loaded`: the memory has these parameters from the last call. */
void network_outputs(const struct network *network, const real *parameters, bool loaded, uint32_t count,
		     const struct observed *observed, real *outputs, real *memory);

#endif
