#include "blackbox/log_ring.h"

#include <stddef.h>

#include "common/fence.h"

_Static_assert((LOG_RING_RECORDS & (LOG_RING_RECORDS - 1u)) == 0,
	       "the place of a record is taken of a number that wraps");

void log_ring_init(struct log_ring *ring, bool keeps)
{
	ring->written = 0;
	ring->taken = 0;
	ring->dropped = 0;
	ring->records[0].samples = 0;
	ring->open = keeps ? ring->records : NULL;
}

const struct log_record *log_ring_next(const struct log_ring *ring)
{
	const uint32_t taken = ring->taken;

	if (ring->written == taken)
		return NULL;
	fence();
	return &ring->records[taken % LOG_RING_RECORDS];
}

void log_ring_take(struct log_ring *ring)
{
	fence();
	++ring->taken;
}
