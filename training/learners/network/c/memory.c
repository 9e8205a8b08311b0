#include "memory.h"

void memory_layout(struct memory *m, struct arena *a, int kind, size_t steps, size_t inputs, size_t units)
{
	const size_t gates = (kind == MEMORY_LSTM ? 4u : 3u) * units;

	m->kind = kind;
	m->units = units;
	dense_layout(&m->input, a, inputs, gates);
	dense_layout(&m->state, a, units, gates);
	m->gates = arena_rows(a, steps * 4u * units);
	m->cells = kind == MEMORY_LSTM ? arena_rows(a, steps * units) : NULL;
	m->nothing = arena_rows(a, padded(units, PART));
	m->by_state = arena_rows(a, padded(units, PART));
	m->kept = arena_rows(a, padded(units, PART));
	m->sums = arena_rows(a, 2u * padded(gates, PART));
}

/* Parameters: W and b of the input, then of the state. */
const real *memory_load(struct memory *m, const real *parameters)
{
	parameters = dense_load(&m->input, parameters);
	rows_clear(m->nothing, padded(m->units, PART));
	rows_clear(m->by_state, padded(m->units, PART));
	rows_clear(m->kept, padded(m->units, PART));
	return dense_load(&m->state, parameters);
}

real *memory_store(const struct memory *m, real *gradient)
{
	return dense_store(&m->state, dense_store(&m->input, gradient));
}

void memory_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after)
{
	(m->kind == MEMORY_LSTM ? lstm_forward : gru_forward)(m, k, x, before != NULL ? before : m->nothing, after);
}

void memory_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x)
{
	before = before != NULL ? before : m->nothing;
	(m->kind == MEMORY_LSTM ? lstm_backward : gru_backward)(m, k, x, before, by_after, by_x);
}
