#include "gru.h"

#include "activation.h"

void gru_layout(struct gru *g, struct arena *a, size_t steps, size_t inputs, size_t units)
{
	g->units = units;
	dense_layout(&g->input, a, inputs, 3u * units);
	dense_layout(&g->state, a, units, 3u * units);
	g->gates = arena_rows(a, steps * 4u * units);
	g->nothing = arena_rows(a, padded(units, PART));
	g->by_state = arena_rows(a, padded(units, PART));
	g->kept = arena_rows(a, padded(units, PART));
	g->sums = arena_rows(a, 2u * padded(3u * units, PART));
}

/* Parameters: W and b of the input, then of the state. */
const real *gru_load(struct gru *g, const real *parameters)
{
	parameters = dense_load(&g->input, parameters);
	rows_clear(g->nothing, padded(g->units, PART));
	rows_clear(g->by_state, padded(g->units, PART));
	return dense_load(&g->state, parameters);
}

real *gru_store(const struct gru *g, real *gradient)
{
	return dense_store(&g->state, dense_store(&g->input, gradient));
}

/* before: the state of control step k - 1; NULL at the first. */
void gru_forward(const struct gru *g, size_t k, const real *x, const real *before, real *after)
{
	const size_t rows = g->units * LANES;
	const real *const state = before != NULL ? before : g->nothing;
	real *const of_input = g->sums, *const of_state = g->sums + padded(3u * g->units, PART) * LANES;
	real *const gates = g->gates + k * 4u * rows;

	dense_forward(&g->input, x, of_input);
	dense_forward(&g->state, state, of_state);
	for (size_t i = 0; i < 2u * rows; ++i)
		gates[i] = logistic_of(of_input[i] + of_state[i]);
	rows_copy(gates + 3u * rows, of_state + 2u * rows, g->units);
	for (size_t i = 0; i < rows; ++i) {
		const real n = tanh_of(real_fma(gates[i], of_state[2u * rows + i], of_input[2u * rows + i]));

		gates[2u * rows + i] = n;
		after[i] = real_fma(gates[rows + i], state[i] - n, n);
	}
}

/* by_after: derivatives by the state after step k, without those through later steps, which are kept here. */
void gru_backward(struct gru *g, size_t k, const real *x, const real *before, const real *by_after, real *by_x)
{
	const size_t rows = g->units * LANES;
	const real *const state = before != NULL ? before : g->nothing;
	const real *const gates = g->gates + k * 4u * rows;
	real *const of_input = g->sums, *const of_state = g->sums + padded(3u * g->units, PART) * LANES;

	for (size_t i = 0; i < rows; ++i) {
		const real r = gates[i], z = gates[rows + i], n = gates[2u * rows + i];
		const real by = by_after[i] + g->by_state[i];
		const real by_n = by * (R(1) - z) * (R(1) - n * n);

		of_input[i] = of_state[i] = by_n * gates[3u * rows + i] * r * (R(1) - r);
		of_input[rows + i] = of_state[rows + i] = by * (state[i] - n) * z * (R(1) - z);
		of_input[2u * rows + i] = by_n;
		of_state[2u * rows + i] = by_n * r;
	}
	for (size_t i = 3u * rows; i < padded(3u * g->units, TILE) * LANES; ++i)
		of_input[i] = of_state[i] = R(0);
	dense_gather(&g->input, of_input, x);
	dense_gather(&g->state, of_state, state);
	dense_backward(&g->input, of_input, by_x);
	dense_backward(&g->state, of_state, g->kept);
	for (size_t i = 0; i < rows; ++i)
		g->by_state[i] = real_fma(by_after[i] + g->by_state[i], gates[rows + i], g->kept[i]);
}
