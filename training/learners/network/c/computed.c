#include "computed.h"

size_t parameter_count(const struct network *network)
{
	size_t count = 0;

	for (size_t i = 0; i < network->layers; ++i)
		count += (network->width[i] + 1u) * (size_t)network->width[i + 1u];
	return count;
}

void computed_layout(struct computed *c, struct arena *a, const struct network *network)
{
	const size_t inputs = padded(network->width[0], LANES), outputs = padded(network->width[network->layers], TILE);

	layers_layout(&c->layers, a, network, 1);
	c->inputs = arena_rows(a, inputs);
	c->outputs = arena_rows(a, outputs);
	c->by_outputs = arena_rows(a, outputs);
	c->by_inputs = arena_rows(a, inputs);
}

/* Rows of up to LANES samples, normalized: those of `order`, or without it those from `start`. Other lanes are 0. */
void computed_take(struct computed *c, const struct observed *o, const int32_t *order, size_t start, size_t samples)
{
	const size_t n = c->layers.network->width[0];

	for (size_t l = 0; l < LANES; ++l) {
		const size_t sample = l >= samples ? 0 : order != NULL ? (size_t)order[l] : start + l;
		const real *const values = o->values + sample * o->stride;

		for (size_t i = 0; i < n; ++i)
			c->inputs[i * LANES + l] = l < samples ? (values[i] - o->mean[i]) * o->factor[i] : R(0);
	}
}

size_t network_memory(const struct network *network)
{
	struct arena a = {0};
	struct computed computed;

	computed_layout(&computed, &a, network);
	return a.used;
}

void network_outputs(const struct network *network, const real *parameters, bool loaded, uint32_t count,
		     const struct observed *observed, real *outputs, real *memory)
{
	struct arena a = {memory, 0};
	struct computed c;
	const size_t width = network->width[network->layers];

	computed_layout(&c, &a, network);
	if (!loaded) {
		rows_clear(c.inputs, padded(network->width[0], LANES));
		layers_load(&c.layers, parameters);
	}
	for (size_t start = 0; start < count; start += LANES) {
		const size_t samples = count - start < LANES ? count - start : LANES;

		computed_take(&c, observed, NULL, start, samples);
		layers_forward(&c.layers, 0, c.inputs, c.outputs);
		for (size_t l = 0; l < samples; ++l)
			for (size_t i = 0; i < width; ++i)
				outputs[(start + l) * width + i] = c.outputs[i * LANES + l];
	}
}
