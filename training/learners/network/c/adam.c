#include "adam.h"

/* Kingma and Ba 2015, algorithm 1; updates: with this one. */
void adam_step(const struct adam *adam, uint64_t updates, real *parameters, const real *gradient, size_t count)
{
	const real a = R(adam->decay[0]), b = R(adam->decay[1]), eps = adam->eps;
	const real step = R(adam->rate / (1.0 - pow(adam->decay[0], (double)updates)));
	const real over = R(1.0 / (1.0 - pow(adam->decay[1], (double)updates)));
	real *const first = adam->first, *const second = adam->second;

	_Pragma("GCC ivdep") for (size_t i = 0; i < count; ++i) {
		const real slope = gradient[i];

		first[i] = a * first[i] + (R(1) - a) * slope;
		second[i] = b * second[i] + (R(1) - b) * slope * slope;
		parameters[i] -= step * first[i] / (real_sqrt(second[i] * over) + eps);
	}
}
