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

#endif
