#include "activation.h"
#include "memory.h"

void gru_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after)
{
	const size_t rows = m->units * LANES;
	real *const of_input = m->sums, *const of_state = m->sums + padded(3u * m->units, PART) * LANES;
	real *const gates = m->gates + k * 4u * rows;

	dense_forward(&m->input, x, of_input);
	dense_forward(&m->state, before, of_state);
	for (size_t i = 0; i < 2u * rows; ++i)
		gates[i] = logistic_of(of_input[i] + of_state[i]);
	rows_copy(gates + 3u * rows, of_state + 2u * rows, m->units);
	for (size_t i = 0; i < rows; ++i) {
		const real n = tanh_of(real_fma(gates[i], of_state[2u * rows + i], of_input[2u * rows + i]));

		gates[2u * rows + i] = n;
		after[i] = real_fma(gates[rows + i], before[i] - n, n);
	}
}

void gru_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x)
{
	const size_t rows = m->units * LANES;
	const real *const gates = m->gates + k * 4u * rows;
	real *const of_input = m->sums, *const of_state = m->sums + padded(3u * m->units, PART) * LANES;

	for (size_t i = 0; i < rows; ++i) {
		const real r = gates[i], z = gates[rows + i], n = gates[2u * rows + i];
		const real by = by_after[i] + m->by_state[i];
		const real by_n = by * (R(1) - z) * (R(1) - n * n);

		of_input[i] = of_state[i] = by_n * gates[3u * rows + i] * r * (R(1) - r);
		of_input[rows + i] = of_state[rows + i] = by * (before[i] - n) * z * (R(1) - z);
		of_input[2u * rows + i] = by_n;
		of_state[2u * rows + i] = by_n * r;
	}
	for (size_t i = 3u * rows; i < padded(3u * m->units, TILE) * LANES; ++i)
		of_input[i] = of_state[i] = R(0);
	dense_gather(&m->input, of_input, x);
	dense_gather(&m->state, of_state, before);
	dense_backward(&m->input, of_input, by_x);
	dense_backward(&m->state, of_state, m->kept);
	for (size_t i = 0; i < rows; ++i)
		m->by_state[i] = real_fma(by_after[i] + m->by_state[i], gates[rows + i], m->kept[i]);
}
