/* A network whose samples are rows of an array, LANES of them at once. */
#ifndef COMPUTED_H
#define COMPUTED_H

#include "network.h"

/* Memory of a network and of the rows that go into it and come out of it. */
struct computed {
	struct layers layers;
	real *inputs, *outputs, *by_outputs, *by_inputs; /* rows */
};

size_t parameter_count(const struct network *network);
void computed_layout(struct computed *c, struct arena *a, const struct network *network);
void computed_take(struct computed *c, const struct observed *o, const int32_t *order, size_t start, size_t samples);

#endif
