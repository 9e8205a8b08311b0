/* Decodes a run of Thumb code: where its instructions lie, and which of them the engine must check or act on. */
#include <stdlib.h>
#include <string.h>

#include "code.h"

enum { LINE = 64 }; /* bytes, of this machine's cache */
enum { NONE = 15, ALL = 0xFFFF, SP = 13, PC = 15 };
enum { SUBS_1 = 0x3801, BNE_BACK = 0xD1FD }; /* SUBS r0, #1, and BNE to the halfword before it */

struct instruction {
	struct special special;
	struct access access;
	uint32_t align;     /* that its access needs [bytes]; 0: it is not checked */
	uint32_t size;
	uint32_t clobbers;  /* registers whose alignment it may change */
	bool always;        /* misaligned is a fault whatever CCR says */
	bool is_special, is_float, calls;
	uint8_t order;      /* enum order */
	uint32_t it;        /* instructions that it makes conditional */
};

static uint32_t thumb_words(uint32_t registers)
{
	return 4u * (uint32_t)__builtin_popcount(registers);
}

static void thumb_acts(struct instruction *i, enum special_kind kind, uint32_t base)
{
	i->special = (struct special){.kind = (uint8_t)kind, .base = (uint8_t)base, .index = NONE, .align = 1};
	i->is_special = true;
}

/* A load or store with an immediate offset. */
static void thumb_accesses(struct instruction *i, uint32_t base, int32_t immediate, uint32_t bytes, bool store, uint32_t align)
{
	i->access = (struct access){
		.base = (uint8_t)base, .index = NONE, .immediate = immediate, .bytes = (uint16_t)bytes, .store = store};
	i->align = align;
}

/* One of 32 bits whose bit 20 says that it loads, whatever is misaligned being a fault. */
static void thumb_accesses_words(struct instruction *i, uint32_t a, int32_t immediate, uint32_t bytes)
{
	thumb_accesses(i, a & 15u, immediate, bytes, !(a & 0x10u), 4);
	i->always = true;
}

static void thumb_narrow(uint32_t w, struct instruction *i)
{
	const uint32_t low = w & 7u, middle = w >> 3 & 7u, five = w >> 6 & 31u, high = w >> 8 & 7u;
	const bool load = w & 0x0800u;

	i->clobbers = ALL;
	if ((w & 0xF800u) == 0x4800u) { /* literal */
		thumb_accesses(i, PC, 4 * (int32_t)(w & 0xFFu), 4, false, 4);
	} else if ((w & 0xF000u) == 0x5000u) { /* register offset (ARMv7-M A5.2.4) */
		static const uint8_t bytes[8] = {4, 2, 1, 1, 4, 2, 1, 2};
		const uint32_t op = w >> 9 & 7u;

		thumb_accesses(i, middle, 0, bytes[op], op < 3u, bytes[op]);
		i->access.index = (uint8_t)five & 7u;
		i->clobbers = op < 3u ? 0u : 1u << low;
	} else if ((w & 0xE000u) == 0x6000u || (w & 0xF000u) == 0x8000u) {
		const uint32_t bytes = (w & 0xF000u) == 0x8000u ? 2u : w & 0x1000u ? 1u : 4u;

		thumb_accesses(i, middle, (int32_t)(five * bytes), bytes, !load, bytes);
		i->clobbers = load ? 1u << low : 0u;
	} else if ((w & 0xF000u) == 0x9000u) { /* against SP, which is always a multiple of 4 */
		thumb_accesses(i, SP, 4 * (int32_t)(w & 0xFFu), 4, !load, 4);
		i->clobbers = load ? 1u << high : 0u;
	} else if ((w & 0xF000u) == 0xC000u) { /* LDM, STM */
		thumb_accesses(i, high, 0, thumb_words(w & 0xFFu), !load, 4);
		i->always = true;
		i->clobbers = load ? w & 0xFFu : 0u;
	} else if ((w & 0xFF00u) == 0xBF00u) {
		i->clobbers = 0;
		if (w & 0xFu)
			i->it = w & 1u ? 4u : w & 2u ? 3u : w & 4u ? 2u : 1u;
		else if (w == 0xBF30u)
			thumb_acts(i, SPECIAL_WAIT, NONE);
	} else if ((w & 0xFFE8u) == 0xB660u) {
		thumb_acts(i, SPECIAL_MASKS, NONE);
		i->clobbers = 0;
	} else if ((w & 0xF600u) == 0xB400u) { /* PUSH, POP */
		const uint32_t bytes = thumb_words(w & 0x1FFu);

		thumb_accesses(i, SP, load ? 0 : -(int32_t)bytes, bytes, !load, 4);
		i->clobbers = load ? ALL : 0u;
	} else if ((w & 0xF000u) == 0x3000u || (w & 0xF800u) == 0x2800u) { /* ADD, SUB, CMP of an 8-bit immediate */
		i->clobbers = (w & 0xF800u) == 0x2800u || (w & 3u) == 0u ? 0u : 1u << high;
	} else if ((w & 0xFC00u) == 0x1C00u) { /* ADD, SUB of a 3-bit immediate */
		i->clobbers = 1u << low;
	} else if ((w & 0xF000u) == 0xD000u || (w & 0xF800u) == 0xE000u || (w & 0xF500u) == 0xB100u) {
		i->clobbers = 0; /* branches */
	} else if (w < 0x1800u || (w & 0xF800u) == 0x2000u) {
		i->clobbers = (w & 0xF800u) == 0x2000u ? 1u << high : 1u << low;
	} else if ((w & 0xFF87u) == 0x4780u) {
		i->calls = true;
	}
}

static void thumb_wide_load_store(uint32_t a, uint32_t b, struct instruction *i)
{
	const uint32_t base = a & 15u, bytes = 1u << (a >> 5 & 3u), target = b >> 12;
	const int32_t far = (int32_t)(b & 0xFFFu), near = b & 0x200u ? (int32_t)(b & 0xFFu) : -(int32_t)(b & 0xFFu);
	const bool load = a & 0x10u, by_register = base != PC && !(a & 0x80u) && !(b & 0x800u);

	i->clobbers = load ? 1u << target : 0u;
	if (load && target == PC && bytes < 4u) /* PLD */
		return;
	thumb_accesses(i, base, a & 0x80u ? far : base == PC ? -far : b & 0x800u && b & 0x400u ? near : 0, bytes, !load, bytes);
	if (by_register) {
		i->access.index = b & 15u;
		i->access.shift = b >> 4 & 3u;
	} else if (base != PC && !(a & 0x80u) && b & 0x100u && b & 3u) {
		i->clobbers |= 1u << base;
	}
}

static void thumb_wide(uint32_t a, uint32_t b, struct instruction *i)
{
	const uint32_t base = a & 15u;
	const bool before = a & 0x100u, load = a & 0x10u;
	const int32_t words = (int32_t)(b & 0xFFu) * 4, offset = a & 0x80u ? words : -words;

	i->clobbers = ALL;
	if ((a & 0xFE40u) == 0xE800u) { /* LDM, STM */
		thumb_accesses_words(i, a, before ? -(int32_t)thumb_words(b) : 0, thumb_words(b));
		i->clobbers = load ? b : 0u;
	} else if ((a & 0xFE40u) == 0xE840u && a & 0x120u) { /* LDRD, STRD */
		thumb_accesses_words(i, a, before ? offset : 0, 8);
		i->clobbers = load ? 1u << (b >> 12) | 1u << (b >> 8 & 15u) : 0u;
	} else if ((a & 0xFFE0u) == 0xE840u) { /* LDREX, STREX */
		thumb_accesses_words(i, a, words, 4);
	} else if ((a & 0xFFE0u) == 0xE8C0u) { /* LDREXB, LDREXH and their stores; TBB, TBH */
		const bool table = (b & 0xE0u) == 0u, half = b & 0x10u;

		thumb_accesses(i, base, 0, half ? 2u : 1u, !load, 0);
		if (table) {
			i->access.index = b & 15u;
			i->access.shift = half;
		}
	} else if ((a & 0xFE00u) == 0xF800u) {
		thumb_wide_load_store(a, b, i);
	} else if ((a & 0xEC00u) == 0xEC00u && ((b >> 8 & 15u) == 10u || (b >> 8 & 15u) == 11u)) {
		i->is_float = true;
		i->clobbers = 0;
		if ((a & 0xFE00u) == 0xEC00u && (a & 0xFFE0u) != 0xEC40u) { /* VLDR, VSTR, VLDM, VSTM, VPUSH */
			const bool single = (a & 0x120u) == 0x100u, doubles = b & 0x100u;
			const uint32_t bytes = single ? (doubles ? 8u : 4u) : (uint32_t)words & (doubles ? ~7u : ~3u);

			thumb_accesses_words(i, a, before ? offset : 0, bytes);
		} else if (load) {
			i->clobbers = 1u << (b >> 12) | 1u << base; /* VMOV, VMRS to the core */
		}
	} else if (a == 0xF3BFu && ((b & 0xFFF0u) == 0x8F40u || (b & 0xFFF0u) == 0x8F50u)) { /* DSB, DMB */
		i->order = ORDER_BARRIER;
		i->clobbers = 0;
	} else if ((a & 0xFFE0u) == 0xF380u && (b & 0xD000u) == 0x8000u) { /* MSR */
		thumb_acts(i, SPECIAL_MASKS, NONE);
		i->clobbers = 0;
	} else if (a == 0xF3EFu && (b & 0xF000u) == 0x8000u) { /* MRS */
		thumb_acts(i, SPECIAL_CONTROL, b >> 8 & 15u);
		i->is_special = (b & 0xFFu) == 20u;
		i->clobbers = 1u << (b >> 8 & 15u);
	} else if ((a & 0xFFD0u) == 0xFB90u && (b & 0xF0F0u) == 0xF0F0u) { /* SDIV, UDIV */
		thumb_acts(i, SPECIAL_DIVIDE, b & 15u);
		i->clobbers = 1u << (b >> 8 & 15u);
	} else if ((a & 0xF800u) == 0xF000u && b & 0x8000u) {
		i->calls = (b & 0xD000u) == 0xD000u;
	} else if ((a & 0xFA00u) == 0xF000u && !(b & 0x8000u)) { /* data processing, immediate */
		/* ADD, SUB of a register and a small multiple of 4 to itself; their wide forms. */
		const uint32_t op = a & 0xFBE0u;
		const bool small = (a & 0x400u) == 0u && (b & 0x7000u) == 0u;
		const bool adds = op == 0xF200u || op == 0xF2A0u || ((op == 0xF100u || op == 0xF1A0u) && small);
		const bool keeps = adds && base == (b >> 8 & 15u) && (b & 3u) == 0u;

		i->clobbers = keeps ? 0u : 1u << (b >> 8 & 15u);
	} else if ((a & 0xFE00u) == 0xEA00u || (a & 0xFF00u) == 0xFB00u || (a & 0xFF00u) == 0xFA00u) {
		i->clobbers = 1u << (b >> 8 & 15u) | 1u << (b >> 12);
	}
}

/* What must be checked of an access: none against SP or PC that is aligned as they are. */
static void thumb_check_access(struct instruction *i)
{
	const struct access *const a = &i->access;

	if (a->bytes == 0u)
		return;
	i->order = a->store && a->base != SP ? ORDER_STORE : ORDER_NONE;
	if (i->align == 0u || a->base == PC ||
	    (a->base == SP && a->index == NONE && (a->immediate & (int32_t)(i->align - 1u)) == 0))
		return;
	i->is_special = true;
	i->special = (struct special){
		.kind = SPECIAL_ACCESS, .base = a->base, .index = a->index, .shift = a->shift, .align = (uint8_t)i->align,
		.immediate = (int16_t)a->immediate, .always = i->always,
	};
}

static uint32_t thumb_halfword(const uint8_t *code)
{
	return (uint32_t)code[0] | (uint32_t)code[1] << 8;
}

static struct instruction thumb_decode(const uint8_t *code, uint32_t room)
{
	struct instruction i = {.size = 2};
	const uint32_t first = thumb_halfword(code);

	if (first < 0xE800u || room < 4u) {
		thumb_narrow(first, &i);
	} else {
		i.size = 4;
		thumb_wide(first, thumb_halfword(code + 2), &i);
	}
	thumb_check_access(&i);
	return i;
}

struct access thumb_access(const uint8_t *code, uint32_t room)
{
	return thumb_decode(code, room).access;
}

/* An access needs no look when its base was looked at before in this block and has kept its alignment since: what
 * is far from the null page stays far from it by the reach of an immediate. */
static bool thumb_is_known(const struct special *s, uint32_t aligned, uint32_t seen)
{
	const bool far = seen >> s->base & 1u, even = aligned >> s->base & 1u;

	return s->kind == SPECIAL_ACCESS && s->index == NONE && far &&
	       (s->align == 1u || (even && (s->immediate & (int32_t)(s->align - 1u)) == 0));
}

struct block *block_decode(const uint8_t *code, uint32_t size, uint32_t opening)
{
	/* One piece of memory: a run of code touches as few places as it may. */
	const size_t most = size / 2u + 1u;
	const size_t bytes = sizeof(struct block) + most * (sizeof(struct special) + sizeof(uint16_t));
	struct block *const block = aligned_alloc(LINE, (bytes + LINE - 1u) / LINE * LINE);
	uint32_t aligned = 0, seen = 0, covered = opening;

	if (block == NULL)
		return NULL;
	memset(block, 0, bytes);
	block->size = size;
	block->opening = (uint16_t)opening;
	block->float_offset = UINT16_MAX;
	block->specials = (struct special *)(block + 1);
	block->offsets = (uint16_t *)(block->specials + most);
	for (uint32_t at = 0; at < size;) {
		struct instruction i = thumb_decode(code + at, size - at);

		block->offsets[block->count++] = (uint16_t)(at | (covered != 0u));
		if (i.is_float && block->float_offset == UINT16_MAX)
			block->float_offset = (uint16_t)at;
		if (i.is_special && !thumb_is_known(&i.special, aligned, seen)) {
			i.special.offset = (uint16_t)at;
			block->specials[block->special_count++] = i.special;
			if (i.special.kind == SPECIAL_ACCESS && i.special.index == NONE && covered == 0u) {
				seen |= 1u << i.special.base;
				if (i.special.align == 4u && (i.special.immediate & 3) == 0)
					aligned |= 1u << i.special.base;
			}
		}
		aligned &= ~i.clobbers;
		seen &= ~i.clobbers;
		block->calls = i.calls;
		covered = i.it ? i.it : covered ? covered - 1u : 0u;
		at += i.size;
	}
	block->open = (uint16_t)covered;
	if (size == 4u && opening == 0u && (thumb_halfword(code) & 0xF8FFu) == SUBS_1 && thumb_halfword(code + 2) == BNE_BACK)
		block->counts = (uint8_t)((code[1] & 7u) + 1u);
	return block;
}

enum order block_order(const uint8_t *code, uint32_t size, const bool *to_device)
{
	enum order last = ORDER_NONE;

	for (uint32_t at = 0; at < size;) {
		const struct instruction i = thumb_decode(code + at, size - at);

		if (i.order == ORDER_BARRIER || (i.order == ORDER_STORE && !to_device[at / 2u]))
			last = (enum order)i.order;
		at += i.size;
	}
	return last;
}

/* A branch, or what may change whether an exception is taken and on which stack. */
static bool thumb_parts(const uint8_t *code, const struct instruction *i)
{
	const uint32_t a = thumb_halfword(code), b = i->size == 4u ? thumb_halfword(code + 2) : 0u;

	if (i->is_special && i->special.kind != SPECIAL_ACCESS && i->special.kind != SPECIAL_DIVIDE)
		return true;
	if (i->size == 2u)
		return (a & 0xF000u) == 0xD000u || (a & 0xF800u) == 0xE000u || (a & 0xF500u) == 0xB100u ||
		       (a & 0xFF00u) == 0x4700u || (a & 0xFF00u) == 0xBD00u;
	return (a & 0xF800u) == 0xF000u && b & 0x8000u && a != 0xF3BFu && a != 0xF3EFu;
}

bool thumb_syncs_next(const uint8_t *code, uint32_t room)
{
	uint32_t at = thumb_decode(code, room).size;

	while (at + 4u <= room) {
		const struct instruction i = thumb_decode(code + at, room - at);

		if (i.order == ORDER_BARRIER)
			return (thumb_halfword(code + at + 2u) & 0xF0u) == 0x40u;
		if (i.order == ORDER_STORE || thumb_parts(code + at, &i))
			return false;
		at += i.size;
	}
	return false;
}
