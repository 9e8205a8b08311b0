/* The control path's whole state between two control steps: where a log begins, so that a replay knows all that came before.
 *
 * It is taken anew from time to time while no log is written, so that a flight finds one that is some steps old whenever it
 * begins. From the background; the interrupt knows nothing of it. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define LOG_SNAPSHOT_STEPS 64u /* control steps from one to the next */

/* The memory to be copied, and the counters that show whether the copy is consistent. */
struct log_state {
	const void *bytes; /* aligned to 8 */
	size_t size; /* a multiple of 8 */
	uint32_t layout; /* what they mean: whoever has the same number can take them */
	const volatile uint32_t *samples; /* gyro samples since boot, that change with each change of the state */
	const volatile uint32_t *window; /* what they were when the last control step had ended */
	const volatile uint32_t *control_steps; /* the number of the next one */
	const uint16_t *held; /* where pointers lie, 8 bytes each: 0 in the copy, as they tell no flight from another */
	size_t held_count;
};

struct log_snapshot {
	struct log_state state;
	void *bytes; /* the copy: as many, and aligned likewise */
	uint32_t step; /* the first control step that is not in it */
	bool taken; /* it is whole */
};

/* Takes it if there is none, or if it is old. Where that cannot be now, what there is stays: it is old, no more. Only a sample
 * that interrupts the copying leaves none. */
void log_snapshot_renew(struct log_snapshot *snapshot);
