/* Rows of LANES numbers, and memory for many of them.
 *
 * Sums run in a fixed order and products are fused with sums only where the source says so: every machine computes the same
 * bits. */
#ifndef LANES_H
#define LANES_H

#include <math.h>
#include <string.h>

#include "api.h"

#ifdef FLOAT64
#define real_fma fma
#define real_rint rint
#define real_floor floor
#define real_sqrt sqrt
#define real_abs fabs
#else
#define real_fma fmaf
#define real_rint rintf
#define real_floor floorf
#define real_sqrt sqrtf
#define real_abs fabsf
#endif

#define R(number) ((real)(number))
#define FOR_LANES(l) _Pragma("GCC ivdep") for (size_t l = 0; l < LANES; ++l)

static inline real least(real a, real b)
{
	return a < b ? a : b;
}

static inline real most(real a, real b)
{
	return a > b ? a : b;
}

static inline real limited(real value, real low, real high)
{
	return least(most(value, low), high);
}

static inline void rows_clear(real *rows, size_t count)
{
	memset(rows, 0, count * LANES * sizeof(real));
}

static inline void rows_copy(real *to, const real *from, size_t count)
{
	memcpy(to, from, count * LANES * sizeof(real));
}

static inline void rows_add(real *to, const real *more, size_t count)
{
	for (size_t i = 0; i < count * LANES; ++i)
		to[i] += more[i];
}

static inline size_t padded(size_t count, size_t multiple)
{
	return (count + multiple - 1u) / multiple * multiple;
}

/* Memory that is handed out piece by piece. With no memory it only counts. */
struct arena {
	real *memory;
	size_t used;
};

static inline real *arena_take(struct arena *a, size_t count)
{
	real *const taken = a->memory != NULL ? a->memory + a->used : NULL;

	a->used += padded(count, LANES);
	return taken;
}

static inline real *arena_rows(struct arena *a, size_t count)
{
	return arena_take(a, count * LANES);
}

#endif
