/* The writer's side of the ring, inside the interrupt that calls it. */
#pragma once

#include "blackbox/log_ring.h"
#include "common/fence.h"

/* The open record is whole. Where there is no room for another one behind it, it is dropped: one place is always
 * the open record's, which the reader does not have. */
static inline void log_ring_close(struct log_ring *ring)
{
	const uint32_t written = ring->written;

	if (written - ring->taken < LOG_RING_RECORDS - 1u) {
		fence();
		ring->written = written + 1u;
		ring->open = &ring->records[(written + 1u) % LOG_RING_RECORDS];
	} else {
		++ring->dropped;
	}
	ring->open->samples = 0;
}
