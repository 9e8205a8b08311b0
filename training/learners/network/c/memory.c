#include "memory.h"

void memory_layout(struct memory *m, struct arena *a, int kind, size_t steps, size_t inputs, size_t units)
{
	m->kind = kind;
	if (kind == MEMORY_LSTM)
		lstm_layout(&m->lstm, a, steps, inputs, units);
	else
		gru_layout(&m->gru, a, steps, inputs, units);
}

const real *memory_load(struct memory *m, const real *parameters)
{
	return m->kind == MEMORY_LSTM ? lstm_load(&m->lstm, parameters) : gru_load(&m->gru, parameters);
}

real *memory_store(const struct memory *m, real *gradient)
{
	return m->kind == MEMORY_LSTM ? lstm_store(&m->lstm, gradient) : gru_store(&m->gru, gradient);
}

void memory_forward(const struct memory *m, size_t k, const real *x, const real *before, real *after)
{
	if (m->kind == MEMORY_LSTM)
		lstm_forward(&m->lstm, k, x, before, after);
	else
		gru_forward(&m->gru, k, x, before, after);
}

void memory_backward(struct memory *m, size_t k, const real *x, const real *before, const real *by_after, real *by_x)
{
	if (m->kind == MEMORY_LSTM)
		lstm_backward(&m->lstm, k, x, before, by_after, by_x);
	else
		gru_backward(&m->gru, k, x, before, by_after, by_x);
}
