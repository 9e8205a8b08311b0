/* What unicorn calls while it runs, and the count of what has been executed.
 *
 * How a slice becomes exact. Unicorn calls on_block before each run of instructions and on_code before each
 * instruction. on_block finds out where, if at all, the run must be left: at the first instruction that starts when
 * something is due. on_code compares one address. Time advances by whole runs, so that an instruction skipped under a
 * condition costs what the others cost, although unicorn does not call for it.
 *
 * A change that an access to a register makes (an interrupt, a nearer alarm) takes effect before the next
 * instruction, never inside the access: unicorn would execute the instruction again. Nothing is interrupted inside
 * an IT block: unicorn goes on to its end. So it does at an instruction there that would fault, which is told as if it
 * had stopped; a handler of the fault finds done what it should not. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../base/machine.h"
#include "../code/code.h"
#include "../system/system.h"
#include "hooks.h"

#define CPACR_FLOATS 0x00F00000u /* full access to the floating-point unit */
#define CCR_UNALIGN_TRP (1u << 3)
#define CCR_DIV_0_TRP (1u << 4)

/* The first `count` instructions of the block, `bytes` long, have been executed. */
static inline void hooks_pass(struct engine *e, const struct block *b, uint32_t count, uint32_t bytes)
{
	e->block = NULL;
	if (e->s.depth <= e->skip_depth)
		e->skip = NOWHERE;
	/* Only jumps are hashed: a run cut in two by an alarm is the same run. */
	if (e->s.last_end != e->start)
		engine_mix(&e->s, (uint64_t)e->s.last_end << 32 | e->start);
	e->s.last_end = e->start + bytes;
	e->s.time += count * e->s.tick;
	e->s.instructions += count;
	if (e->profiling) {
		e->nodes[e->s.node].instructions += count;
		e->s.called = b->calls && count == b->count ? e->s.last_end : NOWHERE;
	}
}

/* A run of instructions that does `last` last has been executed. */
static inline void hooks_order(struct engine *e, enum order last)
{
	struct activation *const a = &e->s.active[e->s.depth];

	if (last == ORDER_NONE)
		return;
	a->stored = last == ORDER_STORE;
	a->part_bytes = 0;
}

static enum order hooks_order_of(struct engine *e, uint32_t start, uint32_t bytes)
{
	return block_order(host(e, start, bytes), bytes, e->to_device + row_of(start));
}

/* Whether a part of a block, of which there are many, has stored is found out when somebody asks: seldom. */
static void hooks_order_part(struct engine *e)
{
	struct activation *const a = &e->s.active[e->s.depth];

	if (a->part_bytes != 0u)
		hooks_order(e, hooks_order_of(e, a->part, a->part_bytes));
	a->part_bytes = 0;
}

bool engine_stored(struct engine *e)
{
	if (e->block == NULL)
		return false; /* not the program */
	const enum order last = e->at == e->start ? ORDER_NONE : hooks_order_of(e, e->start, e->at - e->start);

	hooks_order_part(e);
	return last == ORDER_NONE ? e->s.active[e->s.depth].stored : last == ORDER_STORE;
}

static inline void hooks_pass_whole(struct engine *e, struct block *block)
{
	++block->times;
	hooks_order(e, (enum order)block->order);
	hooks_pass(e, block, block->count, block->size);
}

void hooks_account(struct engine *e, uint32_t count)
{
	struct block *const block = e->block;

	if (count == 0u) {
		e->block = NULL;
	} else if (count == block->count) {
		hooks_pass_whole(e, block);
	} else {
		const uint32_t bytes = block->offsets[count] & ~1u;

		if (block->order != ORDER_NONE) {
			hooks_order_part(e);
			e->s.active[e->s.depth].part = e->start;
			e->s.active[e->s.depth].part_bytes = bytes;
		}
		++e->enters[block->code];
		++e->leaves[block->code + bytes / 2u];
		hooks_pass(e, block, count, bytes);
	}
}

/* ---- what unicorn calls ---- */

/* Where in the block to stop for what is due, by time or by number of instructions. */
static void hooks_plan(struct engine *e)
{
	const struct block *b = e->block;
	const uint64_t due = e->next_due < e->until ? e->next_due : e->until;
	const uint64_t left = due > e->s.time ? due - e->s.time : 0;
	const uint64_t most = e->limit - e->s.instructions;
	uint64_t k = b->count;

	e->event_stop = NOWHERE;
	if (left >= b->count * e->s.tick && most >= b->count && e->breakpoint_count == 0u)
		return;
	if (left < b->count * e->s.tick)
		k = (left + e->s.tick - 1u) / e->s.tick;
	if (most < k)
		k = most;
	while (k < b->count && b->offsets[k] & 1u)
		++k;
	if (k < b->count)
		e->event_stop = e->start + b->offsets[k];
	for (uint32_t i = 0; i < e->breakpoint_count; ++i) {
		const uint32_t address = e->breakpoints[i];

		if (address - e->start < b->size && address != e->skip && address < e->event_stop)
			e->event_stop = address;
	}
}

/* The first floating-point instruction of the block that CPACR does not allow; NOWHERE: none. */
static uint32_t hooks_float_trap(const struct engine *e)
{
	const struct block *b = e->block;

	return e->s.cpacr == CPACR_FLOATS || b->float_offset == UINT16_MAX ? NOWHERE : e->start + b->float_offset;
}

/* Where hooks_consider runs next, at `from` or behind it. */
static void hooks_set_stop(struct engine *e, uint32_t from)
{
	const struct block *b = e->block;
	const uint32_t trap = hooks_float_trap(e);
	uint32_t stop = e->event_stop;

	if (e->next_special < b->special_count && e->start + b->specials[e->next_special].offset < stop)
		stop = e->start + b->specials[e->next_special].offset;
	if (from <= trap && trap < stop)
		stop = trap;
	e->stop_at = e->watch_count != 0u ? 0 : stop;
}

static void hooks_leave(struct engine *e, uint32_t address)
{
	e->stopped = true;
	e->s.pc = address;
	hooks_account(e, clock_index_at(e, address));
	uc_emu_stop(e->uc);
}

/* The instruction at hand would fault: it is not executed. */
static void hooks_reject(struct engine *e, enum exception exception, uint32_t cfsr, const char *format, ...)
{
	va_list arguments;

	e->fault = (struct fault){.exception = exception, .cfsr = cfsr};
	va_start(arguments, format);
	vsnprintf(e->fault.text, sizeof e->fault.text, format, arguments);
	va_end(arguments);
	hooks_leave(e, e->at);
}

static void hooks_check_access(struct engine *e, const struct special *s)
{
	uint32_t address = reg(e, general[s->base]) + (uint32_t)(int32_t)s->immediate;

	if (s->index != 15u)
		address += reg(e, general[s->index]) << s->shift;
	if ((address & (s->align - 1u)) != 0u &&
	    (s->always || e->s.ccr & CCR_UNALIGN_TRP || (address >= APB_BASE && address < 0x60000000u) ||
	     address >= PPB_BASE)) {
		hooks_reject(e, EXC_USAGE, FAULT_UNALIGNED, "unaligned access at 0x%08X, this instruction needs %u bytes' alignment",
		       address, s->align);
	} else if (address < NULL_PAGE_BYTES) {
		hooks_reject(e, EXC_MEM, FAULT_DATA_ACCESS, "access at 0x%08X, in the null page", address);
		e->fault.address = address;
		e->fault.has_address = true;
	}
}

/* Unicorn's core shows ARMv8-M's SFPA, and SPSEL in handlers, which ARMv7-M reads as zero (B1.4.4). */
static void hooks_show_control(struct engine *e)
{
	const int name = general[e->control_in - 1u];

	set_reg(e, name, reg(e, name) & (e->s.depth != 0u ? 5u : 7u));
	e->control_in = 0;
}

static void hooks_special(struct engine *e, const struct special *s)
{
	switch (s->kind) {
	case SPECIAL_ACCESS:
		hooks_check_access(e, s);
		break;
	case SPECIAL_DIVIDE:
		if (e->s.ccr & CCR_DIV_0_TRP && reg(e, general[s->base]) == 0u)
			hooks_reject(e, EXC_USAGE, FAULT_DIVIDE, "division by zero");
		break;
	case SPECIAL_WAIT:
		e->waiting = true;
		break;
	case SPECIAL_CONTROL:
		e->control_in = s->base + 1u;
		clock_attend(e);
		break;
	default:
		e->attention = true; /* masks are read when the next instruction begins */
		e->event_stop = 0;
		break;
	}
}

static void hooks_note_breakpoint(struct engine *e, uint32_t address)
{
	for (uint32_t i = 0; i < e->breakpoint_count; ++i)
		if (e->breakpoints[i] == address && address != e->skip)
			e->at_breakpoint = true;
}

/* Does the loop have to act before the instruction at `address`? */
static bool hooks_want_loop(struct engine *e, uint32_t address)
{
	if (e->failed || e->reset_wanted || e->flash_stored || e->code_changed)
		return true;
	if (address < ITCM_BYTES ? !e->s.itcm_closed : e->s.flash_busy << FRACTION > clock_now(e))
		return true;
	return exceptions_deliverable(e) != EXC_THREAD;
}

/* Stops before a watched access; one inside an IT block stops after that block. Returns whether it has stopped. */
static bool hooks_watch(struct engine *e, uint32_t address)
{
	const uint32_t index = clock_index_at(e, address);

	if (e->block->offsets[index] & 1u) {
		e->watch_passed = e->watch_passed || (!watch_is_skipped(e, index) && watch_sees(e, address));
		return false;
	}
	e->at_watchpoint = !e->watch_passed && address != e->skip && watch_sees(e, address);
	if (e->watch_passed || e->at_watchpoint)
		hooks_leave(e, address);
	return e->stopped;
}

/* An instruction at which something is due, or that must be checked. */
static __attribute__((noinline)) void hooks_consider(struct engine *e, uint32_t address)
{
	const struct block *b = e->block;

	if (e->stopped) /* inside an IT block, to whose end unicorn goes on whatever it is told */
		return;
	if (address < NULL_PAGE_BYTES) {
		hooks_reject(e, EXC_MEM, FAULT_INSTRUCTION_ACCESS, "execution at 0x%08X, in the null page", address);
		e->fault.jumped = true;
		return;
	}
	if (address >= e->event_stop && (b->offsets[clock_index_at(e, address)] & 1u) == 0u) {
		bool stop = true;

		if (e->control_in != 0u)
			hooks_show_control(e);
		if (e->attention) {
			e->attention = false;
			stop = hooks_want_loop(e, address);
			hooks_plan(e);
			stop = stop || address >= e->event_stop;
		}
		if (stop) {
			hooks_note_breakpoint(e, address);
			hooks_leave(e, address);
			return;
		}
	}
	while (e->next_special < b->special_count &&
	       e->start + b->specials[e->next_special].offset <= address) {
		const struct special *s = &b->specials[e->next_special++];

		if (e->start + s->offset == address)
			hooks_special(e, s);
		if (e->stopped)
			return;
	}
	if (address == hooks_float_trap(e)) {
		hooks_reject(e, EXC_USAGE, FAULT_NO_COPROCESSOR,
		       "a floating-point instruction while CPACR = 0x%08X does not allow it", e->s.cpacr);
		return;
	}
	if (e->watch_count != 0u && hooks_watch(e, address))
		return;
	hooks_set_stop(e, address);
}

static void hooks_on_code(uc_engine *uc, uint64_t address, uint32_t size, void *user)
{
	struct engine *e = user;

	(void)uc;
	(void)size;
	e->at = (uint32_t)address;
	if (__builtin_expect((uint32_t)address >= e->stop_at, false))
		hooks_consider(e, (uint32_t)address);
}

/* ITCM is written by start-up once; from its first instruction on it is read-only. */
void hooks_close_itcm(struct engine *e)
{
	if (e->s.itcm_closed)
		return;
	e->s.itcm_closed = true;
	uc_mem_protect(e->uc, ITCM_BASE, ITCM_BYTES, UC_PROT_READ | UC_PROT_EXEC);
}

/* A loop that does nothing but count down, of which waits are made, need not run: all its turns but the last one, and the
 * last before something is due, are counted here, to the same times and the same trace. */
static void hooks_count_down(struct engine *e)
{
	struct block *const b = e->block;
	const int name = general[b->counts - 1u];
	const uint32_t value = reg(e, name);
	const uint64_t due = e->next_due < e->until ? e->next_due : e->until, turn = b->count * e->s.tick;
	const uint64_t in_time = due > e->s.time ? (due - e->s.time) / turn : 0;
	const uint64_t allowed = (e->limit - e->s.instructions) / b->count;
	uint64_t turns = value != 0u ? value : UINT64_C(1) << 32;

	turns = in_time < turns ? in_time : turns;
	turns = allowed < turns ? allowed : turns;
	if (turns < 2u)
		return;
	set_reg(e, name, value - (uint32_t)(turns - 1u));
	hooks_pass_whole(e, b);
	e->block = b;
	turns -= 2u;
	b->times += turns;
	e->s.time += turns * turn;
	e->s.instructions += turns * b->count;
	if (e->profiling)
		e->nodes[e->s.node].instructions += turns * b->count;
	for (; turns != 0u; --turns)
		engine_mix(&e->s, (uint64_t)e->s.last_end << 32 | e->start);
}

static void hooks_on_block(uc_engine *uc, uint64_t address, uint32_t size, void *user)
{
	struct engine *e = user;
	const uint32_t start = (uint32_t)address;
	struct block *const before = e->block;
	uint32_t opening = 0;

	if (e->stopped) {
		uc_emu_stop(uc);
		return;
	}
	if (before != NULL) {
		opening = e->start + before->size == start ? before->open : 0;
		if (before->count != 0u)
			hooks_pass_whole(e, before);
	}
	e->at = e->start = e->s.pc = start;
	e->next_special = 0;
	e->block = blocks_find(e, before, start, size, opening);
	if (e->block == NULL) {
		fail(e, "execution at 0x%08X", start);
		uc_emu_stop(e->uc);
		return;
	}
	__builtin_prefetch(e->block->next);
	if (e->profiling)
		profile_block(e);
	const bool attend = e->attention || (start < ITCM_BYTES && !e->s.itcm_closed) || start < NULL_PAGE_BYTES ||
			    (start >= ITCM_BYTES && e->s.flash_busy << FRACTION > e->s.time);

	if (e->block->counts != 0u && !attend && e->breakpoint_count == 0u && e->watch_count == 0u)
		hooks_count_down(e);
	hooks_plan(e);
	if (attend) {
		e->attention = true;
		e->event_stop = 0;
	}
	hooks_set_stop(e, start);
}

static void hooks_on_interrupt(uc_engine *uc, uint32_t number, void *user)
{
	struct engine *e = user;

	e->interrupt = number;
	uc_emu_stop(uc);
}

static void hooks_note_flash_store(struct engine *e, uint32_t address, uint32_t size, uint32_t value)
{
	const uint32_t offset = (address - FLASH_BASE) & ~3u;

	e->callbacks.flash(e->callbacks.user, address, size, value);
	e->flash_patch = offset;
	memcpy(e->flash_bytes, e->flash + offset, 4);
	e->flash_stored = true;
	clock_attend(e);
}

static bool hooks_on_invalid(uc_engine *uc, uc_mem_type type, uint64_t address, int size, int64_t value, void *user)
{
	struct engine *e = user;

	if (type == UC_MEM_WRITE_PROT && inside((uint32_t)address, (uint32_t)size, FLASH_BASE, FLASH_BYTES) &&
	    e->callbacks.flash != NULL && !e->flash_stored) {
		hooks_note_flash_store(e, (uint32_t)address, (uint32_t)size, (uint32_t)value);
		forget_conditions(uc);
		return true;
	}
	e->fault_type = (uint32_t)type;
	e->fault_at = (uint32_t)address;
	e->fault_size = (uint32_t)size;
	e->fault_value = (uint32_t)value;
	return false;
}

/* Hooks what is above into unicorn. */
uc_err hooks_add(struct engine *e)
{
	/* Memory but RAM, where nothing but a fetch is invalid: under a hook of it, unicorn takes every store by a slow way. */
	const struct {
		int kind;
		void *function;
		uint64_t first, last;
	} hooks[] = {
		{UC_HOOK_BLOCK, (void *)hooks_on_block, 1, 0},
		{UC_HOOK_CODE, (void *)hooks_on_code, 1, 0},
		{UC_HOOK_INTR, (void *)hooks_on_interrupt, 1, 0},
		{UC_HOOK_MEM_INVALID, (void *)hooks_on_invalid, 0, RAM_BASE - 1u},
		{UC_HOOK_MEM_INVALID, (void *)hooks_on_invalid, RAM_BASE + RAM_BYTES, UINT32_MAX},
	};
	uc_err error = UC_ERR_OK;
	uc_hook hook;

	for (uint32_t i = 0; error == UC_ERR_OK && i < sizeof hooks / sizeof *hooks; ++i)
		error = uc_hook_add(e->uc, &hook, hooks[i].kind, hooks[i].function, e, hooks[i].first, hooks[i].last);
	return error;
}
