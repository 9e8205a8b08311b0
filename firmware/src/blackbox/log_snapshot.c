#include "blackbox/log_snapshot.h"

#include "common/fence.h"
#include "common/words.h"

_Static_assert(3u * LOG_SNAPSHOT_STEPS < LOG_RING_RECORDS, "the ring holds what came since the older one");

void log_snapshots_init(struct log_snapshots *snapshots, const struct log_state *state, uint64_t *memory)
{
	*snapshots = (struct log_snapshots){
		.state = *state,
		.kept = { { .bytes = memory }, { .bytes = memory + state->size / sizeof *memory } },
	};
}

/* The interrupt interrupts the copying, never the other way round: it is whole if no sample came meanwhile. */
bool log_snapshot_take(struct log_snapshot *snapshot, const struct log_state *state)
{
	const uint8_t *from = state->bytes;
	uint8_t *to = (uint8_t *)snapshot->bytes;
	const uint32_t before = *state->samples;

	snapshot->taken = false;
	if (before != *state->window)
		return false; /* some samples of the next control step are in it */
	fence();
	size_t left = state->size;
	for (; left >= 64u; left -= 64u, from += 64u, to += 64u)
		words_copy(to, from, 64u);
	for (; left > 0; left -= 8u, from += 8u, to += 8u)
		words_copy(to, from, 8u);
	snapshot->step = *state->control_steps;
	fence();
	snapshot->taken = *state->samples == before;
	return snapshot->taken;
}

static void log_snapshots_let_go(const struct log_snapshots *snapshots, struct log_ring *ring)
{
	const struct log_snapshot *oldest = log_snapshots_oldest(snapshots);

	for (const struct log_record *record; oldest && (record = log_ring_next(ring)) != NULL; log_ring_take(ring))
		if ((int32_t)(record->trace.step - oldest->step) >= 0)
			return;
}

/* The one that is replaced is the older one: until its copy is whole the other is the only one. */
void log_snapshots_step(struct log_snapshots *snapshots, struct log_ring *ring)
{
	const struct log_snapshot *newest = &snapshots->kept[snapshots->newest];
	const unsigned other = snapshots->newest ^ 1u;

	if (!newest->taken || *snapshots->state.control_steps - newest->step >= LOG_SNAPSHOT_STEPS)
		if (log_snapshot_take(&snapshots->kept[other], &snapshots->state))
			snapshots->newest = other;
	log_snapshots_let_go(snapshots, ring);
}

const struct log_snapshot *log_snapshots_oldest(const struct log_snapshots *snapshots)
{
	const struct log_snapshot *newest = &snapshots->kept[snapshots->newest];
	const struct log_snapshot *older = &snapshots->kept[snapshots->newest ^ 1u];

	if (older->taken)
		return older;
	return newest->taken ? newest : NULL;
}
