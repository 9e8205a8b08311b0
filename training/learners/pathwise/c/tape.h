/* What a flight leaves for the backward pass. Rows; T control steps, S samples each. */
#ifndef TAPE_H
#define TAPE_H

#include "api.h"
#include "network/c/network.h"

struct tape {
	size_t width;      /* n, of the observation */
	size_t by_width;   /* n, padded */
	struct layers layers;
	real *rotor_speed; /* ((T - 1) S + 1, M) [rad/s] */
	real *rate;        /* ((T - 1) S + 1, 3) [rad/s] */
	real *ratio;       /* ((T - 1) S + 1), of voltages, with a battery */
	real *value;       /* (AGE_MAX + T, n): terms before their age, scaled; zero before the first step */
	real *free;        /* (T, 3): 1 where the integral is not held at its limit */
	real *estimate;    /* (T, M) [rad/s], modelled rotor speed */
	real *unclipped;   /* (T, M), outputs before they are clipped */
	real *motors;      /* (T, M), fractions after mix and idle */
	real *command;     /* (T, M), as ESCs decode them */
	real *by_motors;   /* (T, M), derivatives of the loss by motors */
	real *by_value;    /* (T + AGE_MAX, by_width), derivatives by the network's inputs at the step at which they are seen */
	real *input;       /* (n), of a step */
	real *passed;      /* (n), of the low-passes */
};

#endif
