#include "activation.h"
#include "memory.h"

static const real *cells_before(const struct memory *m, size_t k)
{
	return k > 0 ? m->cells + (k - 1u) * m->units * LANES : m->nothing;
}

void lstm_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after)
{
	const size_t rows = m->units * LANES;
	real *const of_input = m->sums, *const of_state = m->sums + padded(4u * m->units, PART) * LANES;
	real *const gates = m->gates + k * 4u * rows, *const cells = m->cells + k * rows;
	const real *const cells_old = cells_before(m, k);

	dense_forward(&m->input, x, of_input);
	dense_forward(&m->state, before, of_state);
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

void lstm_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x)
{
	const size_t rows = m->units * LANES;
	const real *const gates = m->gates + k * 4u * rows, *const cells = m->cells + k * rows;
	const real *const cells_old = cells_before(m, k);
	real *const by_sum = m->sums;

	for (size_t i = 0; i < rows; ++i) {
		const real in = gates[i], keep = gates[rows + i], new = gates[2u * rows + i], out = gates[3u * rows + i];
		const real by = by_after[i] + m->by_state[i], cell = tanh_of(cells[i]);
		const real by_cell = real_fma(by * out, R(1) - cell * cell, m->kept[i]);

		by_sum[i] = by_cell * new * in * (R(1) - in);
		by_sum[rows + i] = by_cell * cells_old[i] * keep * (R(1) - keep);
		by_sum[2u * rows + i] = by_cell * in * (R(1) - new * new);
		by_sum[3u * rows + i] = by * cell * out * (R(1) - out);
		m->kept[i] = by_cell * keep;
	}
	dense_gather(&m->input, by_sum, x);
	dense_gather(&m->state, by_sum, before);
	dense_backward(&m->input, by_sum, by_x);
	dense_backward(&m->state, by_sum, m->by_state);
}
