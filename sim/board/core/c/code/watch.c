/* Watchpoints: tells whether a debugger watches the memory that the next instruction accesses.
 *
 * Only the core's own accesses count, as for a DWT comparator; DMA and the stack frames of exceptions do not. Sections
 * (A5, A7) are those of the ARMv7-M Architecture Reference Manual. */
#include "../base/machine.h"
#include "code.h"

enum { PC = 15 }; /* in place of a register; as an index: none */

/* Address of the first byte that the instruction at `at` accesses. */
static uint32_t watch_address(struct engine *e, uint32_t at, const struct access *access)
{
	const bool indexed = access->index != PC;
	uint32_t address = reg(e, general[access->base]);

	if (access->base == PC)
		address = indexed ? at + 4u : (at + 4u) & ~3u; /* of TBB and TBH, of a literal */
	return address + (uint32_t)access->immediate + (indexed ? reg(e, general[access->index]) << access->shift : 0u);
}

/* Returns whether a condition holds: ConditionPassed() of A7.3.1. */
static bool watch_holds(uint32_t condition, uint32_t psr)
{
	const bool n = psr >> 31 & 1u, z = psr >> 30 & 1u, c = psr >> 29 & 1u, v = psr >> 28 & 1u;
	const bool plain[8] = {z, c, n, v, c && !z, n == v, n == v && !z, true};

	return plain[condition >> 1] != ((condition & 1u) != 0u && condition != 15u);
}

bool watch_is_skipped(struct engine *e, uint32_t index)
{
	const struct block *const b = e->block;
	uint32_t first = index;

	while (first > 0u && b->offsets[first] & 1u)
		--first;
	if (b->offsets[first] & 1u || !(b->offsets[index] & 1u))
		return false; /* in no IT block, or in one that began in the block before */
	const uint32_t it = host(e, e->start + b->offsets[first], 2)[0];
	const uint32_t last_bit = (it & 0x1Fu) << (index - first - 1u) >> 4 & 1u;

	return !watch_holds((it >> 4 & 0xEu) | last_bit, reg(e, UC_ARM_REG_XPSR));
}

bool watch_sees(struct engine *e, uint32_t at)
{
	const struct access access = thumb_access(host(e, at, 2), host(e, at, 4) != NULL ? 4 : 2);
	const uint32_t first = access.bytes != 0u ? watch_address(e, at, &access) : 0u;

	for (uint32_t i = 0; i < e->watch_count && access.bytes != 0u; ++i) {
		const struct watchpoint *const w = &e->watchpoints[i];
		const uint32_t into = first - w->address, ahead = w->address - first;

		if (!(access.store ? w->stores : w->loads) || (into >= w->size && ahead >= access.bytes))
			continue;
		e->watch_hit = (struct watch_hit){.number = i, .address = into < w->size ? first : w->address};
		return true;
	}
	return false;
}

int engine_set_watchpoints(struct engine *e, const struct watchpoint *watchpoints, uint32_t count)
{
	if (count > WATCHPOINT_MAX)
		return -1;
	for (uint32_t i = 0; i < count; ++i)
		e->watchpoints[i] = watchpoints[i];
	e->watch_count = count;
	e->watch_passed = false;
	clock_attend(e);
	return 0;
}

const struct watch_hit *engine_watch_hit(const struct engine *e)
{
	return &e->watch_hit;
}
