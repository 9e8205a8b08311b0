#include "network.h"

#include "activation.h"

void layers_layout(struct layers *n, struct arena *a, const struct network *network, size_t steps)
{
	size_t widest = 0;

	n->network = network;
	for (size_t i = 0; i < network->layers; ++i) {
		const size_t inputs = network->width[i], outputs = network->width[i + 1u];

		if (i == 0 && network->memory != MEMORY_NONE)
			memory_layout(&n->memory, a, network->memory, steps, inputs, outputs);
		else
			dense_layout(&n->dense[i], a, inputs, outputs);
		n->stored[i] = padded(outputs, PART);
		n->hidden[i] = arena_rows(a, steps * n->stored[i]);
		widest = n->stored[i] > widest ? n->stored[i] : widest;
	}
	n->by_sum = arena_rows(a, widest);
	n->by_hidden = arena_rows(a, widest);
}

void layers_load(struct layers *n, const real *parameters)
{
	for (size_t i = 0; i < n->network->layers; ++i)
		parameters = i == 0 && n->network->memory != MEMORY_NONE ? memory_load(&n->memory, parameters) :
									   dense_load(&n->dense[i], parameters);
}

void layers_store(const struct layers *n, real *gradient)
{
	for (size_t i = 0; i < n->network->layers; ++i)
		gradient = i == 0 && n->network->memory != MEMORY_NONE ? memory_store(&n->memory, gradient) :
									 dense_store(&n->dense[i], gradient);
}

static real *layers_hidden(const struct layers *n, size_t i, size_t k)
{
	return n->hidden[i] + k * n->stored[i] * LANES;
}

void layers_squash(int activation, real *values, size_t count)
{
	if (activation == ACTIVATION_TANH)
		for (size_t i = 0; i < count * LANES; ++i)
			values[i] = tanh_of(values[i]);
	else
		for (size_t i = 0; i < count * LANES; ++i)
			values[i] = most(values[i], R(0));
}

/* Derivatives by an activation's sums, of those by its values. */
void layers_unsquash(int activation, const real *values, const real *by_value, real *by_sum, size_t count)
{
	if (activation == ACTIVATION_TANH)
		for (size_t i = 0; i < count * LANES; ++i)
			by_sum[i] = by_value[i] * (R(1) - values[i] * values[i]);
	else
		for (size_t i = 0; i < count * LANES; ++i)
			by_sum[i] = values[i] > R(0) ? by_value[i] : R(0);
}

/* Motor fractions before the clip (M rows) of the scaled observation x at control step k. */
void layers_forward(const struct layers *n, size_t k, const real *x, real *unclipped)
{
	const struct network *const net = n->network;
	const size_t last = net->layers - 1u, motors = net->width[net->layers];
	real *output = NULL;

	for (size_t i = 0; i < net->layers; ++i) {
		output = layers_hidden(n, i, k);
		if (i == 0 && net->memory != MEMORY_NONE) {
			memory_forward(&n->memory, k, x, k > 0 ? layers_hidden(n, 0, k - 1u) : NULL, output);
		} else {
			dense_forward(&n->dense[i], x, output);
			if (i < last)
				layers_squash(net->activation, output, padded(net->width[i + 1u], TILE));
		}
		x = output;
	}
	if (net->squash)
		layers_squash(ACTIVATION_TANH, output, motors);
	for (size_t i = 0; i < motors * LANES; ++i)
		unclipped[i] = net->scale * output[i] + net->offset;
}

/* From derivatives by the motor fractions to those by the observation; adds those by the parameters to their sums. Control
 * steps come from the last to the first. */
void layers_backward(struct layers *n, size_t k, const real *x, const real *by_unclipped, real *by_x)
{
	const struct network *const net = n->network;
	const size_t last = net->layers - 1u, motors = net->width[net->layers];

	rows_clear(n->by_sum, padded(motors, TILE));
	for (size_t i = 0; i < motors * LANES; ++i)
		n->by_sum[i] = net->scale * by_unclipped[i];
	if (net->squash)
		layers_unsquash(ACTIVATION_TANH, layers_hidden(n, last, k), n->by_sum, n->by_sum, motors);
	for (size_t i = last; i > 0; --i) {
		const real *const value = layers_hidden(n, i - 1u, k);
		const size_t rows = padded(net->width[i], TILE);

		dense_gather(&n->dense[i], n->by_sum, value);
		dense_backward(&n->dense[i], n->by_sum, n->by_hidden);
		if (i == 1 && net->memory != MEMORY_NONE) {
			memory_backward(&n->memory, k, x, k > 0 ? layers_hidden(n, 0, k - 1u) : NULL, n->by_hidden, by_x);
			return;
		}
		layers_unsquash(net->activation, value, n->by_hidden, n->by_sum, rows);
	}
	dense_gather(&n->dense[0], n->by_sum, x);
	dense_backward(&n->dense[0], n->by_sum, by_x);
}
