/* Time: where it stands inside a run of instructions, the core's clock, and when the next event is due. */
#define _POSIX_C_SOURCE 199309L
#include <time.h>

#include "machine.h"

uint64_t clock_host_ns(const struct engine *e)
{
	struct timespec now;

	if (!e->clocked)
		return 0;
	clock_gettime(CLOCK_MONOTONIC, &now);
	return (uint64_t)now.tv_sec * UINT64_C(1000000000) + (uint64_t)now.tv_nsec;
}

/* Index of the instruction at `address` in the block. */
uint32_t clock_index_at(const struct engine *e, uint32_t address)
{
	const struct block *b = e->block;
	const uint32_t offset = address - e->start;
	uint32_t low = 0, high = b->count;

	while (high - low > 1u) {
		const uint32_t middle = (low + high) / 2u;

		if ((b->offsets[middle] & ~1u) <= offset)
			low = middle;
		else
			high = middle;
	}
	return low;
}

uint64_t clock_now(const struct engine *e)
{
	return e->block == NULL ? e->s.time : e->s.time + clock_index_at(e, e->at) * e->s.tick;
}

uint64_t clock_core_cycles(const struct engine *e, uint64_t time)
{
	const struct state *s = &e->s;

	if (s->core_hz == TIME_HZ)
		return s->core_cycles + ((time - s->core_time) >> FRACTION);
	return s->core_cycles + (uint64_t)(((unsigned __int128)(time - s->core_time) * s->core_hz / TIME_HZ) >> FRACTION);
}

static uint64_t clock_time_of(const struct engine *e, uint64_t cycles)
{
	const struct state *s = &e->s;

	if (cycles <= s->core_cycles)
		return s->core_time;
	if (s->core_hz == TIME_HZ)
		return s->core_time + ((cycles - s->core_cycles) << FRACTION);
	const unsigned __int128 ticks = (unsigned __int128)(cycles - s->core_cycles) << FRACTION;
	return s->core_time + (uint64_t)((ticks * TIME_HZ + s->core_hz - 1u) / s->core_hz);
}

void clock_set_core(struct engine *e, uint64_t hz)
{
	const uint64_t time = clock_now(e), cycles = clock_core_cycles(e, time);

	e->s.core_time = time;
	e->s.core_cycles = cycles;
	e->s.core_hz = hz;
	/* The rest of the block that runs is taken at the old rate: it moves by less than a block. */
	e->s.tick = e->s.cpi * TIME_HZ / hz;
	clock_alarms_changed(e);
}

void clock_attend(struct engine *e)
{
	e->attention = true;
	e->stop_at = e->event_stop = 0;
}

uint64_t clock_systick_due(const struct engine *e)
{
	return e->s.syst_zero == NEVER ? NEVER : clock_time_of(e, e->s.syst_zero);
}

void clock_alarms_changed(struct engine *e)
{
	uint64_t next = clock_systick_due(e);

	for (uint32_t i = 0; i < e->alarm_count; ++i)
		if (e->s.due[i] != NEVER && e->s.due[i] << FRACTION < next)
			next = e->s.due[i] << FRACTION;
	e->next_due = next;
	clock_attend(e);
}
