/* Rows, 3 x 3 matrices and sums whose order is fixed.
 *
 * Products of matrices are chains of fused multiply-adds, which every machine rounds alike: one aircraft alone gets the
 * bits that it gets among others, and every machine the same. Without the fused ones, no expression is contracted
 * (-ffp-contract=off). */
#ifndef VECTOR_H
#define VECTOR_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api.h"

/* A row of k numbers times a matrix (k, m). */
static inline __attribute__((always_inline)) void row_times(const double *row, const double *matrix, size_t k, size_t m,
							    double *out)
{
	for (size_t j = 0; j < m; ++j)
		out[j] = 0.0;
	for (size_t i = 0; i < k; ++i)
		for (size_t j = 0; j < m; ++j)
			out[j] = fma(row[i], matrix[i * m + j], out[j]);
}

/* All products of two of three numbers. */
static inline void squares(const double *v, double *out)
{
	for (size_t i = 0; i < 3; ++i)
		for (size_t j = 0; j < 3; ++j)
			out[3 * i + j] = v[i] * v[j];
}

/* A vector turned by a rotation matrix. */
static inline void turned(const double *rotation, const double *v, double *out)
{
	for (size_t i = 0; i < 3; ++i)
		out[i] = rotation[3 * i] * v[0] + rotation[3 * i + 2] * v[2] + rotation[3 * i + 1] * v[1];
}

/* A vector turned by the inverse of a rotation matrix. */
static inline void turned_back(const double *rotation, const double *v, double *out)
{
	for (size_t i = 0; i < 3; ++i)
		out[i] = rotation[i] * v[0] + rotation[3 + i] * v[1] + rotation[6 + i] * v[2];
}

#endif
