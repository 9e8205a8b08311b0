#include "lstm.h"

#include "activation.h"

void lstm_layout(struct lstm *l, struct arena *a, size_t steps, size_t inputs, size_t units)
{
	l->units = units;
	dense_layout(&l->input, a, inputs, 4u * units);
	dense_layout(&l->state, a, units, 4u * units);
	l->gates = arena_rows(a, steps * 4u * units);
	l->cells = arena_rows(a, steps * units);
	l->nothing = arena_rows(a, padded(units, PART));
	l->by_state = arena_rows(a, padded(units, PART));
	l->by_cell = arena_rows(a, units);
	l->sums = arena_rows(a, 2u * padded(4u * units, PART));
}

/* Parameters: W and b of the input, then of the state. */
const real *lstm_load(struct lstm *l, const real *parameters)
{
	parameters = dense_load(&l->input, parameters);
	rows_clear(l->nothing, padded(l->units, PART));
	rows_clear(l->by_state, padded(l->units, PART));
	rows_clear(l->by_cell, l->units);
	return dense_load(&l->state, parameters);
}

real *lstm_store(const struct lstm *l, real *gradient)
{
	return dense_store(&l->state, dense_store(&l->input, gradient));
}

static const real *cells_before(const struct lstm *l, size_t k)
{
	return k > 0 ? l->cells + (k - 1u) * l->units * LANES : l->nothing;
}

/* before: the state of control step k - 1; NULL at the first. */
void lstm_forward(const struct lstm *l, size_t k, const real *x, const real *before, real *after)
{
	const size_t rows = l->units * LANES;
	real *const of_input = l->sums, *const of_state = l->sums + padded(4u * l->units, PART) * LANES;
	real *const gates = l->gates + k * 4u * rows, *const cells = l->cells + k * rows;
	const real *const cells_old = cells_before(l, k);

	dense_forward(&l->input, x, of_input);
	dense_forward(&l->state, before != NULL ? before : l->nothing, of_state);
	for (size_t i = 0; i < 2u * rows; ++i)
		gates[i] = logistic_of(of_input[i] + of_state[i]);
	for (size_t i = 2u * rows; i < 3u * rows; ++i)
		gates[i] = tanh_of(of_input[i] + of_state[i]);
	for (size_t i = 3u * rows; i < 4u * rows; ++i)
		gates[i] = logistic_of(of_input[i] + of_state[i]);
	for (size_t i = 0; i < rows; ++i) {
		cells[i] = real_fma(gates[rows + i], cells_old[i], gates[i] * gates[2u * rows + i]);
		after[i] = gates[3u * rows + i] * tanh_of(cells[i]);
	}
}

/* by_after: derivatives by the state after step k, without those through later steps, which are kept here. */
void lstm_backward(struct lstm *l, size_t k, const real *x, const real *before, const real *by_after, real *by_x)
{
	const size_t rows = l->units * LANES;
	const real *const gates = l->gates + k * 4u * rows, *const cells = l->cells + k * rows;
	const real *const cells_old = cells_before(l, k);
	real *const by_sum = l->sums;

	for (size_t i = 0; i < rows; ++i) {
		const real in = gates[i], keep = gates[rows + i], new = gates[2u * rows + i], out = gates[3u * rows + i];
		const real by = by_after[i] + l->by_state[i], cell = tanh_of(cells[i]);
		const real by_cell = real_fma(by * out, R(1) - cell * cell, l->by_cell[i]);

		by_sum[i] = by_cell * new * in * (R(1) - in);
		by_sum[rows + i] = by_cell * cells_old[i] * keep * (R(1) - keep);
		by_sum[2u * rows + i] = by_cell * in * (R(1) - new * new);
		by_sum[3u * rows + i] = by * cell * out * (R(1) - out);
		l->by_cell[i] = by_cell * keep;
	}
	dense_gather(&l->input, by_sum, x);
	dense_gather(&l->state, by_sum, before != NULL ? before : l->nothing);
	dense_backward(&l->input, by_sum, by_x);
	dense_backward(&l->state, by_sum, l->by_state);
}
