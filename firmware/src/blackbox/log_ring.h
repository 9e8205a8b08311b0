/* A ring of control step records from the gyro's interrupt to the background: one writer, one reader, neither waits.
 * log_writer.h has the interrupt's part. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "blackbox/log_record.h"

#define LOG_RING_RECORDS 256u /* a quarter of a second at 1 kHz; a power of two */

struct log_ring {
	/* The writer's. */
	struct log_record *open; /* of the next control step and the samples before it; NULL: nothing is kept */
	volatile uint32_t written; /* records since boot */
	volatile uint32_t dropped; /* control steps that found the ring full */
	/* The reader's. */
	volatile uint32_t taken;
	struct log_record records[LOG_RING_RECORDS];
};

/* Empty. keeps: false: nothing is ever recorded. Before the first sample. */
void log_ring_init(struct log_ring *ring, bool keeps);

/* From the background: the oldest record not yet taken, or NULL. It stays as it is until log_ring_take. */
const struct log_record *log_ring_next(const struct log_ring *ring);

/* From the background: done with that one. */
void log_ring_take(struct log_ring *ring);
