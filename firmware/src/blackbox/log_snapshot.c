#include "blackbox/log_snapshot.h"

#include "common/fence.h"
#include "common/words.h"

/* The interrupt interrupts the copying, never the other way round: it is whole if no sample came meanwhile. */
static void log_snapshot_take(struct log_snapshot *snapshot)
{
	const struct log_state *state = &snapshot->state;
	const uint8_t *from = state->bytes;
	uint8_t *to = snapshot->bytes;
	const uint32_t before = *state->samples;

	if (before == 0 || before != *state->window)
		return; /* no control step yet, or some samples of the next one are in it */
	fence();
	for (size_t left = state->size; left > 0; left -= 8u, from += 8u, to += 8u)
		words_copy(to, from, 8u);
	for (size_t i = 0; i < state->held_count; ++i)
		words_copy((uint8_t *)snapshot->bytes + state->held[i], &(const uint64_t){ 0 }, 8u);
	snapshot->step = *state->control_steps;
	fence();
	snapshot->taken = *state->samples == before;
}

void log_snapshot_renew(struct log_snapshot *snapshot)
{
	if (!snapshot->taken || *snapshot->state.control_steps - snapshot->step >= LOG_SNAPSHOT_STEPS)
		log_snapshot_take(snapshot);
}
