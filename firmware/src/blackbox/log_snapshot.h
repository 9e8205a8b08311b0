/* The control path's whole state between two control steps: where a log begins, so that a replay knows all that came before.
 *
 * Two are kept by turns while the motors stand, so that a flight finds one that is some steps old whenever it begins. From the
 * background; the interrupt knows nothing of them. */
#ifndef NF_LOG_SNAPSHOT_H
#define NF_LOG_SNAPSHOT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "blackbox/log_ring.h"

#define LOG_SNAPSHOT_STEPS 64u /* control steps from one to the next; the ring holds more than two of these */

/* What is copied, and how the copy is known to be whole. */
struct log_state {
	const void *bytes; /* aligned to 8 */
	size_t size; /* a multiple of 8 */
	const volatile uint32_t *samples; /* gyro samples since boot, that change with each change of the state */
	const volatile uint32_t *window; /* what they were when the last control step had ended */
	const volatile uint32_t *control_steps; /* the number of the next one */
};

struct log_snapshot {
	uint32_t step; /* the first control step that is not in it */
	bool taken;
	uint64_t *bytes; /* log_state's */
};

struct log_snapshots {
	struct log_state state;
	struct log_snapshot kept[2];
	unsigned newest;
};

/* None taken yet. memory: two places of state->size bytes each. */
void log_snapshots_init(struct log_snapshots *snapshots, const struct log_state *state, uint64_t *memory);

/* Again and again while no log is written and the motors stand: takes one when it is due, and lets go of the records that are
 * older than both. */
void log_snapshots_step(struct log_snapshots *snapshots, struct log_ring *ring);

/* Copies the state as it stands, if no sample came since the last control step, nor while it was copied. */
bool log_snapshot_take(struct log_snapshot *snapshot, const struct log_state *state);

/* The older of the two, whose records are all in the ring; NULL: there is none yet. */
const struct log_snapshot *log_snapshots_oldest(const struct log_snapshots *snapshots);

#endif
