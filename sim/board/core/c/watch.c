/* Watchpoints: decodes which memory the next instruction accesses, and tells whether a debugger watches it.
 *
 * Only the core's own accesses count, as for a DWT comparator; DMA and the stack frames of exceptions do not. Sections
 * (A5, A7) are those of the ARMv7-M Architecture Reference Manual. */
#include "clock.h"
#include "memory.h"
#include "watch.h"

enum { SP = 13, PC = 15 };

/* Memory that an instruction loads or stores; size [bytes] 0: none. */
struct access {
	uint32_t address, size;
	bool store;
};

static uint32_t watch_register(struct engine *e, uint32_t at, uint32_t number)
{
	return number == PC ? (at + 4u) & ~3u : reg(e, general[number]);
}

/* Decodes an instruction of 16 bits (A5.2). */
static struct access watch_narrow(struct engine *e, uint32_t at, uint32_t w)
{
	const uint32_t base = w >> 3 & 7u, five = w >> 6 & 31u, eight = w & 0xFFu;
	const bool store = !(w & 0x0800u);

	switch (w >> 12) {
	case 0x4:
		if (!store)
			return (struct access){watch_register(e, at, PC) + 4u * eight, 4, false};
		break;
	case 0x5: {
		static const uint8_t bytes[8] = {4, 2, 1, 1, 4, 2, 1, 2};
		const uint32_t op = w >> 9 & 7u;

		return (struct access){reg(e, general[base]) + reg(e, general[five & 7u]), bytes[op], op < 3u};
	}
	case 0x6:
	case 0x7:
	case 0x8: {
		const uint32_t bytes = w & 0x8000u ? 2u : w & 0x1000u ? 1u : 4u;

		return (struct access){reg(e, general[base]) + five * bytes, bytes, store};
	}
	case 0x9:
		return (struct access){reg(e, general[SP]) + 4u * eight, 4, store};
	case 0xB: {
		const uint32_t bytes = 4u * (uint32_t)__builtin_popcount(w & 0x1FFu);

		if ((w & 0x0600u) == 0x0400u) /* PUSH, POP */
			return (struct access){reg(e, general[SP]) - (store ? bytes : 0u), bytes, store};
		break;
	}
	case 0xC:
		return (struct access){reg(e, general[w >> 8 & 7u]), 4u * (uint32_t)__builtin_popcount(eight), store};
	default:
		break;
	}
	return (struct access){0};
}

/* Decodes the load or store of a single register, in any addressing mode (A5.3.7 to A5.3.10). */
static struct access watch_single(struct engine *e, uint32_t at, uint32_t a, uint32_t b)
{
	const uint32_t base = a & 15u, bytes = 1u << (a >> 5 & 3u);
	const bool store = !(a & 0x10u);
	uint32_t address = watch_register(e, at, base);

	if (!store && b >> 12 == PC && bytes < 4u) /* PLD, PLI */
		return (struct access){0};
	if (base == PC)
		address += a & 0x80u ? b & 0xFFFu : 0u - (b & 0xFFFu);
	else if (a & 0x80u)
		address += b & 0xFFFu;
	else if (!(b & 0x800u))
		address += reg(e, general[b & 15u]) << (b >> 4 & 3u);
	else if (b & 0x400u)
		address += b & 0x200u ? b & 0xFFu : 0u - (b & 0xFFu);
	return (struct access){address, bytes, store};
}

/* Decodes the instructions of 32 bits that load or store several registers, exclusively, or branch by a table (A5.3.5,
 * A5.3.6, A5.3.11). */
static struct access watch_several(struct engine *e, uint32_t at, uint32_t a, uint32_t b)
{
	const uint32_t base = watch_register(e, at, a & 15u), words = b & 0xFFu;
	const bool before = a & 0x100u, back = a & 0x20u, store = !(a & 0x10u);
	const uint32_t offset = a & 0x80u ? 4u * words : 0u - 4u * words;

	if ((a & 0xFE40u) == 0xE800u) { /* LDM, STM */
		const uint32_t bytes = 4u * (uint32_t)__builtin_popcount(b);

		return (struct access){base - (before ? bytes : 0u), bytes, store};
	}
	if ((a & 0xFE00u) == 0xEC00u) { /* VLDR, VSTR; VLDM, VSTM, VPUSH, VPOP */
		const bool doubles = b & 0x100u;

		if (before && !back)
			return (struct access){base + offset, doubles ? 8u : 4u, store};
		return (struct access){base - (before ? 4u * words : 0u), 4u * (doubles ? words & ~1u : words), store};
	}
	if (before || back) /* LDRD, STRD */
		return (struct access){base + (before ? offset : 0u), 8, store};
	if (!(a & 0x80u)) /* LDREX, STREX */
		return (struct access){base + 4u * words, 4, store};
	const uint32_t op = b >> 4 & 15u;

	if (op >= 4u) /* LDREXB, LDREXH and their stores */
		return (struct access){base, op == 4u ? 1u : 2u, store};
	const uint32_t table = (a & 15u) == PC ? at + 4u : base; /* TBB, TBH */

	return (struct access){table + (reg(e, general[b & 15u]) << op), 1u << op, false};
}

static struct access watch_decode(struct engine *e, uint32_t at)
{
	const uint8_t *const code = host(e, at, 2), *const more = host(e, at + 2u, 2);
	const uint32_t a = (uint32_t)code[0] | (uint32_t)code[1] << 8;

	if (a < 0xE800u || more == NULL)
		return watch_narrow(e, at, a);
	const uint32_t b = (uint32_t)more[0] | (uint32_t)more[1] << 8;

	if ((a & 0xFE00u) == 0xF800u)
		return watch_single(e, at, a, b);
	const bool floats = (a & 0xFE00u) == 0xEC00u && (b & 0xE00u) == 0xA00u && (a & 0xFFE0u) != 0xEC40u;

	if ((a & 0xFE00u) == 0xE800u || floats)
		return watch_several(e, at, a, b);
	return (struct access){0};
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
	const struct access access = watch_decode(e, at);

	for (uint32_t i = 0; i < e->watch_count && access.size != 0u; ++i) {
		const struct watchpoint *const w = &e->watchpoints[i];
		const uint32_t into = access.address - w->address, ahead = w->address - access.address;

		if (!(access.store ? w->stores : w->loads) || (into >= w->size && ahead >= access.size))
			continue;
		e->watch_hit = (struct watch_hit){.number = i, .address = into < w->size ? access.address : w->address};
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
