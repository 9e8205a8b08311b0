/* Motor commands on their way to the rotors. */
#include <string.h>

#include "vector.h"

/* Takes the commands (N, M) computed from this sample and gives those that act from it to the next. False, and nothing is
 * changed: one of them is not in 0..1. */
bool delay_step(struct delay *d, size_t count, const double *command, double *acting)
{
	const size_t all = count * d->motors, row = d->motors * sizeof(double);

	for (size_t i = 0; i < all; ++i)
		if (!(command[i] >= 0.0 && command[i] <= 1.0))
			return false;
	memcpy(d->commands + d->sample % d->slots * all, command, count * row);
	for (size_t i = 0; i < count; ++i) {
		const size_t slot = (d->sample + d->slots - (uint64_t)d->delays[i]) % d->slots;

		memcpy(acting + i * d->motors, d->commands + slot * all + i * d->motors, row);
	}
	++d->sample;
	return true;
}
