#include "dense.h"

#if defined(__FMA__) && !defined(FLOAT64)
#include <immintrin.h>
#endif

typedef real part __attribute__((vector_size(PART * sizeof(real)), aligned(sizeof(real)), may_alias));

#define INLINE static inline __attribute__((always_inline))

INLINE part part_fma(part a, part b, part c)
{
#if defined(__FMA__) && !defined(FLOAT64)
	return (part)_mm256_fmadd_ps((__m256)a, (__m256)b, (__m256)c);
#else
	for (size_t i = 0; i < PART; ++i)
		c[i] = real_fma(a[i], b[i], c[i]);
	return c;
#endif
}

INLINE part part_of(real value)
{
	return (part){value, value, value, value, value, value, value, value};
}

INLINE part part_load(const real *at)
{
	return *(const part *)at;
}

INLINE void part_store(real *at, part value)
{
	*(part *)at = value;
}

void dense_layout(struct dense *d, struct arena *a, size_t inputs, size_t outputs)
{
	const size_t rows = padded(outputs, TILE);

	d->inputs = inputs;
	d->outputs = outputs;
	d->forward = arena_take(a, rows * inputs);
	d->bias = arena_take(a, rows);
	d->backward = arena_take(a, padded(inputs, TILE) * outputs);
	d->by_weight = arena_take(a, rows * padded(inputs, LANES));
	d->by_bias = arena_rows(a, rows);
	d->turned = arena_rows(a, padded(inputs, LANES));
}

/* Takes W (outputs, inputs) and b from `parameters`, returns what follows them, and clears the gradient. */
const real *dense_load(struct dense *d, const real *parameters)
{
	const size_t rows = padded(d->outputs, TILE), columns = padded(d->inputs, TILE);
	const real *const bias = parameters + d->outputs * d->inputs;

	for (size_t o = 0; o < rows; ++o) {
		const bool real_row = o < d->outputs;

		d->bias[o] = real_row ? bias[o] : R(0);
		for (size_t i = 0; i < d->inputs; ++i)
			d->forward[(o / TILE * d->inputs + i) * TILE + o % TILE] =
				real_row ? parameters[o * d->inputs + i] : R(0);
	}
	for (size_t i = 0; i < columns; ++i)
		for (size_t o = 0; o < d->outputs; ++o)
			d->backward[(i / TILE * d->outputs + o) * TILE + i % TILE] =
				i < d->inputs ? parameters[o * d->inputs + i] : R(0);
	memset(d->by_weight, 0, rows * padded(d->inputs, LANES) * sizeof(real));
	rows_clear(d->by_bias, rows);
	return bias + d->outputs;
}

/* TILE rows of a product: y = bias + sum over i of weight[i] x[i]. */
INLINE void dense_tile(const real *weight, const real *bias, size_t inputs, const real *x, real *y)
{
	part sum[TILE][2];

	for (size_t t = 0; t < TILE; ++t)
		sum[t][0] = sum[t][1] = part_of(bias != NULL ? bias[t] : R(0));
	for (size_t i = 0; i < inputs; ++i) {
		const part low = part_load(x + i * LANES), high = part_load(x + i * LANES + PART);

		for (size_t t = 0; t < TILE; ++t) {
			const part factor = part_of(weight[i * TILE + t]);

			sum[t][0] = part_fma(factor, low, sum[t][0]);
			sum[t][1] = part_fma(factor, high, sum[t][1]);
		}
	}
	for (size_t t = 0; t < TILE; ++t) {
		part_store(y + t * LANES, sum[t][0]);
		part_store(y + t * LANES + PART, sum[t][1]);
	}
}

/* Rows y (outputs) of rows x (inputs). */
void dense_forward(const struct dense *d, const real *x, real *y)
{
	for (size_t o = 0; o < d->outputs; o += TILE)
		dense_tile(d->forward + o * d->inputs, d->bias + o, d->inputs, x, y + o * LANES);
}

/* From derivatives by y to those by x. */
void dense_backward(const struct dense *d, const real *by_y, real *by_x)
{
	for (size_t i = 0; i < d->inputs; i += TILE)
		dense_tile(d->backward + i * d->outputs, NULL, d->outputs, by_y, by_x + i * LANES);
}

/* 8 x 8 numbers: rows of LANES become columns of a matrix with rows of `stride`. */
INLINE void dense_turn(const real *from, real *to, size_t stride)
{
	for (size_t i = 0; i < PART; ++i)
		for (size_t j = 0; j < PART; ++j)
			to[j * stride + i] = from[i * LANES + j];
}

/* TILE by LANES numbers of the gradient, summed over the lanes. */
INLINE void dense_gather_tile(const real *by_y, const real *turned, size_t stride, real *sums)
{
	part sum[TILE][2];

	for (size_t t = 0; t < TILE; ++t) {
		sum[t][0] = part_load(sums + t * stride);
		sum[t][1] = part_load(sums + t * stride + PART);
	}
	for (size_t l = 0; l < LANES; ++l) {
		const part low = part_load(turned + l * stride), high = part_load(turned + l * stride + PART);

		for (size_t t = 0; t < TILE; ++t) {
			const part factor = part_of(by_y[t * LANES + l]);

			sum[t][0] = part_fma(factor, low, sum[t][0]);
			sum[t][1] = part_fma(factor, high, sum[t][1]);
		}
	}
	for (size_t t = 0; t < TILE; ++t) {
		part_store(sums + t * stride, sum[t][0]);
		part_store(sums + t * stride + PART, sum[t][1]);
	}
}

/* Adds the derivatives by W and b to their sums. */
void dense_gather(struct dense *d, const real *by_y, const real *x)
{
	const size_t stride = padded(d->inputs, LANES);
	real *const turned = d->turned;

	for (size_t i = 0; i < d->inputs; i += PART)
		for (size_t l = 0; l < LANES; l += PART)
			dense_turn(x + i * LANES + l, turned + l * stride + i, stride);
	for (size_t o = 0; o < d->outputs; o += TILE)
		for (size_t i = 0; i < d->inputs; i += LANES)
			dense_gather_tile(by_y + o * LANES, turned + i, stride, d->by_weight + o * stride + i);
	for (size_t i = 0; i < d->outputs * LANES; ++i)
		d->by_bias[i] += by_y[i];
}

/* Writes the gradient in the order of the parameters, and returns what follows it. */
real *dense_store(const struct dense *d, real *gradient)
{
	const size_t stride = padded(d->inputs, LANES);
	real *const bias = gradient + d->outputs * d->inputs;

	for (size_t o = 0; o < d->outputs; ++o) {
		real sum = R(0);

		memcpy(gradient + o * d->inputs, d->by_weight + o * stride, d->inputs * sizeof(real));
		for (size_t l = 0; l < LANES; ++l)
			sum += d->by_bias[o * LANES + l];
		bias[o] = sum;
	}
	return bias + d->outputs;
}
