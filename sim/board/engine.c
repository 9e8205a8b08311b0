/* The engine of the emulated board: memory, time and the loop that runs unicorn in exact slices.
 *
 * How a slice becomes exact. Unicorn calls on_block before each run of instructions and on_code before each
 * instruction. on_block finds out where, if at all, the run must be left: at the first instruction that starts when
 * something is due. on_code compares one address. Time advances by whole runs, so that an instruction skipped under a
 * condition costs what the others cost, although unicorn does not call for it.
 *
 * A change that an access to a register makes (an interrupt, a nearer alarm) takes effect before the next
 * instruction, never inside the access: unicorn would execute the instruction again. Nothing is interrupted inside
 * an IT block. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "engine.h"

#define BLOCK_ADDRESSES_END 0xFFFFFFFEu /* an address that is never reached: unicorn wants one */
#define CPI_ONE ((uint64_t)1 << FRACTION)
#define HSI_HZ UINT64_C(16000000)
#define FAULT_INSTRUCTION_ACCESS 1u        /* CFSR bits (B3.2.15) */
#define FAULT_DATA_ACCESS (1u << 1)
#define FAULT_BUS_INSTRUCTION (1u << 8)
#define FAULT_BUS_PRECISE (1u << 9)
#define FAULT_UNDEFINED (1u << 16)
#define FAULT_NO_COPROCESSOR (1u << 19)
#define FAULT_UNALIGNED (1u << 24)
#define FAULT_DIVIDE (1u << 25)
#define CCR_UNALIGN_TRP (1u << 3)
#define CCR_DIV_0_TRP (1u << 4)

/* Unicorn's numbers. */
enum { INTERRUPT_SVC = 2, INTERRUPT_PREFETCH = 3, INTERRUPT_BKPT = 7, INTERRUPT_EXCEPTION_RETURN = 8 };

/* ---- registers, memory ---- */

uint32_t reg(struct engine *e, int name)
{
	uint32_t value = 0;

	uc_reg_read(e->uc, name, &value);
	return value;
}

void set_reg(struct engine *e, int name, uint32_t value)
{
	uc_reg_write(e->uc, name, &value);
}

static bool inside(uint32_t address, uint32_t size, uint32_t base, uint32_t bytes)
{
	return address >= base && address - base < bytes && size <= bytes - (address - base);
}

uint8_t *host(struct engine *e, uint32_t address, uint32_t size)
{
	if (inside(address, size, RAM_BASE, RAM_BYTES))
		return e->ram + (address - RAM_BASE);
	if (inside(address, size, FLASH_BASE, FLASH_BYTES))
		return e->flash + (address - FLASH_BASE);
	if (inside(address, size, ALIAS_BASE, FLASH_BYTES))
		return e->flash + (address - ALIAS_BASE);
	if (inside(address, size, ITCM_BASE, ITCM_BYTES))
		return e->itcm + address;
	if (inside(address, size, SYSTEM_BASE, SYSTEM_BYTES))
		return e->system + (address - SYSTEM_BASE);
	return NULL;
}

uint32_t row_of(uint32_t address)
{
	if (address < ITCM_BYTES)
		return address / 2u;
	if (inside(address, 2, FLASH_BASE, FLASH_BYTES))
		return ITCM_HALFWORDS + (address - FLASH_BASE) / 2u;
	if (inside(address, 2, ALIAS_BASE, FLASH_BYTES))
		return ITCM_HALFWORDS + (address - ALIAS_BASE) / 2u;
	return NOWHERE;
}

/* ---- failure ---- */

/* The first failure stands: what follows it may be its consequence. */
void fail(struct engine *e, const char *format, ...)
{
	va_list arguments;

	look_again(e);
	if (e->failed)
		return;
	e->failed = true;
	e->last_pc = e->block != NULL ? e->at : e->s.pc;
	va_start(arguments, format);
	vsnprintf(e->message, sizeof e->message, format, arguments);
	va_end(arguments);
}

/* ---- time ---- */

/* Index of the instruction at `address` in the block. */
static uint32_t index_at(const struct engine *e, uint32_t address)
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

uint64_t now(const struct engine *e)
{
	return e->block == NULL ? e->s.time : e->s.time + index_at(e, e->at) * e->s.tick;
}

uint64_t core_cycles_at(const struct engine *e, uint64_t time)
{
	const struct state *s = &e->s;

	if (s->core_hz == TIME_HZ)
		return s->core_cycles + ((time - s->core_time) >> FRACTION);
	return s->core_cycles + (uint64_t)(((unsigned __int128)(time - s->core_time) * s->core_hz / TIME_HZ) >> FRACTION);
}

uint64_t time_of_core_cycles(const struct engine *e, uint64_t cycles)
{
	const struct state *s = &e->s;

	if (cycles <= s->core_cycles)
		return s->core_time;
	if (s->core_hz == TIME_HZ)
		return s->core_time + ((cycles - s->core_cycles) << FRACTION);
	const unsigned __int128 ticks = (unsigned __int128)(cycles - s->core_cycles) << FRACTION;
	return s->core_time + (uint64_t)((ticks * TIME_HZ + s->core_hz - 1u) / s->core_hz);
}

static void set_core_clock(struct engine *e, uint64_t hz)
{
	const uint64_t time = now(e), cycles = core_cycles_at(e, time);

	e->s.core_time = time;
	e->s.core_cycles = cycles;
	e->s.core_hz = hz;
	/* The rest of the block that runs is taken at the old rate: it moves by less than a block. */
	e->s.tick = e->s.cpi * TIME_HZ / hz;
	alarms_changed(e);
}

void look_again(struct engine *e)
{
	e->attention = true;
	e->stop_at = e->event_stop = 0;
}

void alarms_changed(struct engine *e)
{
	uint64_t next = systick_due(e);

	for (uint32_t i = 0; i < e->alarm_count; ++i)
		if (e->s.due[i] != NEVER && e->s.due[i] << FRACTION < next)
			next = e->s.due[i] << FRACTION;
	e->next_due = next;
	look_again(e);
}

static void fire_due(struct engine *e)
{
	while (!e->failed && e->next_due <= e->s.time) {
		uint64_t first = systick_due(e);
		uint32_t which = ALARM_MAX;

		for (uint32_t i = 0; i < e->alarm_count; ++i)
			if (e->s.due[i] != NEVER && e->s.due[i] << FRACTION < first) {
				first = e->s.due[i] << FRACTION;
				which = i;
			}
		if (which == ALARM_MAX) {
			systick_fire(e);
		} else {
			e->s.due[which] = NEVER;
			e->on_alarm(which);
		}
		alarms_changed(e);
	}
}

/* ---- counts ---- */

void mix(struct engine *e, uint64_t value)
{
	uint64_t h = (e->s.hash ^ value) * UINT64_C(0x9E3779B97F4A7C15);

	e->s.hash = h ^ h >> 29;
}

/* The first `count` instructions of the block have been executed. */
static void account(struct engine *e, uint32_t count)
{
	struct block *const block = e->block;
	const struct block *const b = block;
	const uint32_t bytes = count < b->count ? b->offsets[count] & ~1u : b->size;

	e->block = NULL;
	if (count == 0u)
		return;
	e->skip = NOWHERE;
	/* Only jumps are hashed: a run cut in two by an alarm is the same run. */
	if (e->s.last_end != e->start)
		mix(e, (uint64_t)e->s.last_end << 32 | e->start);
	e->s.last_end = e->start + bytes;
	e->s.time += count * e->s.tick;
	e->s.instructions += count;
	if (count == b->count) {
		++block->times;
	} else {
		++e->enters[e->code];
		++e->leaves[e->code + bytes / 2u];
	}
	if (e->profiling) {
		e->nodes[e->s.node].instructions += count;
		e->s.called = b->calls && count == b->count ? e->s.last_end : NOWHERE;
	}
}

/* ---- what unicorn calls ---- */

/* Where in the block to stop for what is due, by time or by number of instructions. */
static void plan(struct engine *e)
{
	const struct block *b = e->block;
	const uint64_t due = e->next_due < e->until ? e->next_due : e->until;
	const uint64_t left = due > e->s.time ? due - e->s.time : 0;
	const uint64_t most = e->limit - e->s.instructions;
	uint64_t k = b->count;

	e->event_stop = NOWHERE;
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

static void set_stop(struct engine *e)
{
	const struct block *b = e->block;
	uint32_t stop = e->event_stop;

	if (e->next_special < b->special_count && e->start + b->specials[e->next_special].offset < stop)
		stop = e->start + b->specials[e->next_special].offset;
	e->stop_at = stop;
}

static void leave(struct engine *e, uint32_t address)
{
	e->stopped = true;
	e->s.pc = address;
	account(e, index_at(e, address));
	uc_emu_stop(e->uc);
}

/* The instruction at hand would fault: it is not executed. */
static void refuse(struct engine *e, enum exception exception, uint32_t cfsr, const char *format, ...)
{
	va_list arguments;

	e->fault = (struct fault){.exception = exception, .cfsr = cfsr};
	va_start(arguments, format);
	vsnprintf(e->fault.text, sizeof e->fault.text, format, arguments);
	va_end(arguments);
	leave(e, e->at);
}

static const int general[16] = {
	UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3, UC_ARM_REG_R4, UC_ARM_REG_R5,
	UC_ARM_REG_R6, UC_ARM_REG_R7, UC_ARM_REG_R8, UC_ARM_REG_R9, UC_ARM_REG_R10, UC_ARM_REG_R11,
	UC_ARM_REG_R12, UC_ARM_REG_SP, UC_ARM_REG_LR, UC_ARM_REG_PC,
};

static void check_access(struct engine *e, const struct special *s)
{
	uint32_t address = reg(e, general[s->base]) + (uint32_t)(int32_t)s->immediate;

	if (s->index != 15u)
		address += reg(e, general[s->index]) << s->shift;
	if ((address & (s->align - 1u)) != 0u &&
	    (s->always || e->s.ccr & CCR_UNALIGN_TRP || (address >= APB_BASE && address < 0x60000000u) ||
	     address >= PPB_BASE)) {
		refuse(e, EXC_USAGE, FAULT_UNALIGNED, "unaligned access at 0x%08X, this instruction needs %u bytes' alignment",
		       address, s->align);
	} else if (address < NULL_PAGE_BYTES) {
		refuse(e, EXC_MEM, FAULT_DATA_ACCESS, "access at 0x%08X, in the null page", address);
		e->fault.address = address;
		e->fault.has_address = true;
	}
}

/* Unicorn's core shows ARMv8-M's SFPA, and SPSEL in handlers, which ARMv7-M reads as zero (B1.4.4). */
static void show_control(struct engine *e)
{
	const int name = general[e->control_in - 1u];

	set_reg(e, name, reg(e, name) & (e->s.depth != 0u ? 5u : 7u));
	e->control_in = 0;
}

static void special(struct engine *e, const struct special *s)
{
	switch (s->kind) {
	case SPECIAL_ACCESS:
		check_access(e, s);
		break;
	case SPECIAL_DIVIDE:
		if (e->s.ccr & CCR_DIV_0_TRP && reg(e, general[s->base]) == 0u)
			refuse(e, EXC_USAGE, FAULT_DIVIDE, "division by zero");
		break;
	case SPECIAL_WAIT:
		e->waiting = true;
		break;
	case SPECIAL_CONTROL:
		e->control_in = s->base + 1u;
		look_again(e);
		break;
	default:
		e->attention = true; /* masks are read when the next instruction begins */
		e->event_stop = 0;
		break;
	}
}

static void note_breakpoint(struct engine *e, uint32_t address)
{
	for (uint32_t i = 0; i < e->breakpoint_count; ++i)
		if (e->breakpoints[i] == address && address != e->skip)
			e->at_breakpoint = true;
}

/* Does the loop have to see this before the instruction at `address`? */
static bool wants_loop(struct engine *e, uint32_t address)
{
	if (e->failed || e->reset_wanted || e->flash_stored || e->code_changed)
		return true;
	if (address < ITCM_BYTES ? !e->s.itcm_closed : e->s.flash_busy << FRACTION > now(e))
		return true;
	return deliverable(e) != EXC_THREAD;
}

/* An instruction that may have to wait: something is due, or it needs a look. */
static __attribute__((noinline)) void consider(struct engine *e, uint32_t address)
{
	const struct block *b = e->block;

	if (address >= e->event_stop && (b->offsets[index_at(e, address)] & 1u) == 0u) {
		bool stop = true;

		if (e->control_in != 0u)
			show_control(e);
		if (e->attention) {
			e->attention = false;
			stop = wants_loop(e, address);
			plan(e);
			stop = stop || address >= e->event_stop;
		}
		if (stop) {
			note_breakpoint(e, address);
			leave(e, address);
			return;
		}
	}
	while (e->next_special < b->special_count &&
	       e->start + b->specials[e->next_special].offset <= address) {
		const struct special *s = &b->specials[e->next_special++];

		if (e->start + s->offset == address)
			special(e, s);
		if (e->stopped)
			return;
	}
	if (e->s.cpacr != 0x00F00000u && b->float_offset != UINT16_MAX && address == e->start + b->float_offset) {
		refuse(e, EXC_USAGE, FAULT_NO_COPROCESSOR,
		       "a floating-point instruction while CPACR = 0x%08X does not allow it", e->s.cpacr);
		return;
	}
	set_stop(e);
	if (e->s.cpacr != 0x00F00000u && b->float_offset != UINT16_MAX && address < e->start + b->float_offset &&
	    e->start + b->float_offset < e->stop_at)
		e->stop_at = e->start + b->float_offset;
}

static void on_code(uc_engine *uc, uint64_t address, uint32_t size, void *user)
{
	struct engine *e = user;

	(void)uc;
	(void)size;
	e->at = (uint32_t)address;
	if ((uint32_t)address >= e->stop_at)
		consider(e, (uint32_t)address);
}

static void count_block(struct engine *e, struct block *block)
{
	e->enters[block->code] += block->times;
	e->leaves[block->code + block->size / 2u] += block->times;
	block->times = 0;
}

static void drop_block(struct engine *e, uint32_t row)
{
	if (e->blocks[row] != NULL)
		count_block(e, e->blocks[row]);
	block_free(e->blocks[row]);
	e->blocks[row] = NULL;
}

/* The counts of blocks that are still in use, into the books. */
static void count_all(struct engine *e)
{
	for (uint32_t row = 0; row < CODE_HALFWORDS; ++row)
		if (e->blocks[row] != NULL)
			count_block(e, e->blocks[row]);
}

static struct block *find_block(struct engine *e, uint32_t start, uint32_t size, uint32_t opening)
{
	struct block **place = &e->blocks[e->code];

	if (*place != NULL && (*place)->size == size && (*place)->opening == opening)
		return *place;
	drop_block(e, e->code);
	*place = block_decode(host(e, start, size), size, opening);
	if (*place != NULL)
		(*place)->code = e->code;
	return *place;
}

/* ITCM is written by start-up once; from its first instruction on it is read-only. */
static void close_itcm(struct engine *e)
{
	if (e->s.itcm_closed)
		return;
	e->s.itcm_closed = true;
	uc_mem_protect(e->uc, ITCM_BASE, ITCM_BYTES, UC_PROT_READ | UC_PROT_EXEC);
}

static void on_block(uc_engine *uc, uint64_t address, uint32_t size, void *user)
{
	struct engine *e = user;
	const uint32_t start = (uint32_t)address;
	uint32_t opening = 0;

	(void)uc;
	if (e->block != NULL) {
		opening = e->start + e->block->size == start ? e->block->open : 0;
		account(e, e->block->count);
	}
	e->at = e->start = e->s.pc = start;
	e->code = row_of(start);
	e->next_special = 0;
	e->stopped = false;
	e->block = e->code == NOWHERE ? NULL : find_block(e, start, size, opening);
	if (e->block == NULL) {
		fail(e, "execution at 0x%08X", start);
		uc_emu_stop(e->uc);
		return;
	}
	if (e->profiling)
		profile_block(e);
	plan(e);
	if (e->attention || (start < ITCM_BYTES && !e->s.itcm_closed) ||
	    (start >= ITCM_BYTES && e->s.flash_busy << FRACTION > e->s.time)) {
		e->attention = true;
		e->event_stop = 0;
	}
	set_stop(e);
	if (e->s.cpacr != 0x00F00000u && e->block->float_offset != UINT16_MAX &&
	    start + e->block->float_offset < e->stop_at)
		e->stop_at = start + e->block->float_offset;
}

static void on_interrupt(uc_engine *uc, uint32_t number, void *user)
{
	struct engine *e = user;

	e->interrupt = number;
	uc_emu_stop(uc);
}

static void note_flash_store(struct engine *e, uint32_t address, uint32_t size, uint32_t value)
{
	const uint32_t offset = (address - FLASH_BASE) & ~3u;

	e->on_flash(address, size, value);
	e->flash_patch = offset;
	memcpy(e->flash_bytes, e->flash + offset, 4);
	e->flash_stored = true;
	look_again(e);
}

static bool on_invalid(uc_engine *uc, uc_mem_type type, uint64_t address, int size, int64_t value, void *user)
{
	struct engine *e = user;

	(void)uc;
	if (type == UC_MEM_WRITE_PROT && inside((uint32_t)address, (uint32_t)size, FLASH_BASE, FLASH_BYTES) &&
	    e->on_flash != NULL && !e->flash_stored) {
		note_flash_store(e, (uint32_t)address, (uint32_t)size, (uint32_t)value);
		return true;
	}
	e->fault_type = (uint32_t)type;
	e->fault_at = (uint32_t)address;
	e->fault_size = (uint32_t)size;
	e->fault_value = (uint32_t)value;
	return false;
}

static int window_at(const struct engine *e, uint32_t address)
{
	if (address - APB_BASE < APB_BYTES)
		return e->apb[(address - APB_BASE) >> 10];
	if (address - AHB2_BASE < AHB2_BYTES)
		return e->ahb2[(address - AHB2_BASE) >> 10];
	return address >= PPB_BASE && address - PPB_BASE < PPB_BYTES ? e->ppb[(address - PPB_BASE) >> 10] : -1;
}

static uint32_t device_read(struct engine *e, uint32_t address, uint32_t size)
{
	const int found = window_at(e, address);

	if (found >= 0) {
		++e->windows[found].reads;
		return e->on_read((uint32_t)found, address - e->windows[found].base, size);
	}
	if (address >= PPB_BASE)
		return system_read(e, address, size);
	fail(e, "read of %u bytes at 0x%08X, where no modelled peripheral is", size, address);
	return 0;
}

static void device_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value)
{
	const int found = window_at(e, address);

	if (found >= 0) {
		++e->windows[found].writes;
		e->on_write((uint32_t)found, address - e->windows[found].base, size, value);
	} else if (address >= PPB_BASE) {
		system_write(e, address, size, value);
	} else {
		fail(e, "write of 0x%X (%u bytes) to 0x%08X, where no modelled peripheral is", value, size, address);
	}
}

static uint64_t read_apb(uc_engine *uc, uint64_t offset, unsigned size, void *user)
{
	(void)uc;
	return device_read(user, APB_BASE + (uint32_t)offset, size);
}

static void write_apb(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user)
{
	(void)uc;
	device_write(user, APB_BASE + (uint32_t)offset, size, (uint32_t)value);
}

static uint64_t read_ahb2(uc_engine *uc, uint64_t offset, unsigned size, void *user)
{
	(void)uc;
	return device_read(user, AHB2_BASE + (uint32_t)offset, size);
}

static void write_ahb2(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user)
{
	(void)uc;
	device_write(user, AHB2_BASE + (uint32_t)offset, size, (uint32_t)value);
}

static uint64_t read_ppb(uc_engine *uc, uint64_t offset, unsigned size, void *user)
{
	(void)uc;
	return device_read(user, PPB_BASE + (uint32_t)offset, size);
}

static void write_ppb(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user)
{
	(void)uc;
	device_write(user, PPB_BASE + (uint32_t)offset, size, (uint32_t)value);
}

/* ---- the loop ---- */

/* Code was changed from outside. Not while unicorn runs. */
static void forget_code(struct engine *e)
{
	e->code_changed = false;
	for (uint32_t row = 0; row < CODE_HALFWORDS; ++row)
		drop_block(e, row);
	uc_ctl_flush_tb(e->uc);
	uc_ctl_flush_tlb(e->uc);
}

/* What unicorn could not go on with becomes a fault of the core. `e->s.pc` stands on the instruction. */
static void explain(struct engine *e, uc_err error)
{
	struct fault *f = &e->fault;
	const uint32_t at = e->fault_at;

	*f = (struct fault){.exception = EXC_BUS, .address = at, .has_address = true};
	switch (error) {
	case UC_ERR_READ_UNMAPPED:
	case UC_ERR_WRITE_UNMAPPED:
	case UC_ERR_WRITE_PROT:
	case UC_ERR_READ_PROT:
	case UC_ERR_READ_UNALIGNED:
	case UC_ERR_WRITE_UNALIGNED: {
		const bool write = error == UC_ERR_WRITE_UNMAPPED || error == UC_ERR_WRITE_PROT;
		const bool closed = mpu_closes(e, at);
		const char *where = at < RAM_BASE && at >= RAM_BASE - 0x10000u ? "below DTCM: the stack overflows" :
				    at < ITCM_BYTES && write ? "in ITCM after its copy" :
				    host(e, at, 1) != NULL   ? "in memory that is read-only" :
							       "where nothing is";

		f->exception = closed ? EXC_MEM : EXC_BUS;
		f->cfsr = closed ? FAULT_DATA_ACCESS : FAULT_BUS_PRECISE;
		snprintf(f->text, sizeof f->text, "%s of %u bytes at 0x%08X, %s", write ? "write" : "read", e->fault_size,
			 at, where);
		break;
	}
	case UC_ERR_FETCH_UNMAPPED:
	case UC_ERR_FETCH_PROT:
		f->exception = error == UC_ERR_FETCH_PROT ? EXC_MEM : EXC_BUS;
		f->cfsr = error == UC_ERR_FETCH_PROT ? FAULT_INSTRUCTION_ACCESS : FAULT_BUS_INSTRUCTION;
		f->has_address = false;
		snprintf(f->text, sizeof f->text, "execution at 0x%08X, %s", e->s.pc,
			 error == UC_ERR_FETCH_PROT ? "in RAM; code runs from flash and ITCM" : "where nothing is");
		break;
	case UC_ERR_INSN_INVALID:
		f->exception = EXC_USAGE;
		f->cfsr = FAULT_UNDEFINED;
		f->has_address = false;
		snprintf(f->text, sizeof f->text, "undefined instruction");
		break;
	default:
		f->exception = EXC_THREAD;
		fail(e, "the processor's model stopped: %s", uc_strerror(error));
	}
}

static void supervisor_call(struct engine *e)
{
	const struct fault escalated = {
		.exception = EXC_HARD, .hfsr = 1u << 30, .text = "SVC where its priority does not let it run"};

	e->s.pended_at[EXC_SVC] = e->s.time;
	if (execution_priority(e, true) > e->s.priority[EXC_SVC])
		exception_enter(e, EXC_SVC);
	else
		raise_fault(e, &escalated);
}

/* Unicorn has come back by itself or because of us. */
static void settle(struct engine *e, uc_err error)
{
	const bool fetch = error == UC_ERR_FETCH_UNMAPPED || error == UC_ERR_FETCH_PROT;

	if (e->stopped) { /* leave() has done the books */
		if (e->fault.exception != EXC_THREAD)
			raise_fault(e, &e->fault);
		return;
	}
	e->s.pc = reg(e, UC_ARM_REG_PC);
	if (e->block != NULL) {
		const bool whole = error == UC_ERR_OK || fetch;

		if (!whole)
			e->s.pc = e->at;
		account(e, whole ? e->block->count : index_at(e, e->at));
	}
	if (e->failed)
		return;
	if (e->interrupt == INTERRUPT_PREFETCH)
		error = UC_ERR_FETCH_UNMAPPED;
	if (error != UC_ERR_OK) {
		explain(e, error);
		if (!e->failed)
			raise_fault(e, &e->fault);
	} else if (e->interrupt == INTERRUPT_SVC) {
		supervisor_call(e);
	} else if (e->interrupt == INTERRUPT_EXCEPTION_RETURN) {
		exception_return(e, e->s.pc | 1u);
	} else if (e->interrupt == INTERRUPT_BKPT) {
		fail(e, "a BKPT instruction");
	} else if (e->interrupt != UINT32_MAX) {
		fail(e, "the processor's model raised its exception %u", e->interrupt);
	} else if (e->waiting) {
		e->s.sleeping = true;
	} else {
		fail(e, "the processor's model stopped without a reason");
	}
}

static void execute(struct engine *e)
{
	if (e->code_changed)
		forget_code(e);
	e->block = NULL;
	e->control_in = 0;
	e->stopped = e->waiting = e->flash_stored = false;
	e->interrupt = UINT32_MAX;
	e->fault.exception = EXC_THREAD;
	settle(e, uc_emu_start(e->uc, e->s.pc | 1u, BLOCK_ADDRESSES_END, 0, 0));
	if (e->code_changed)
		forget_code(e);
	if (e->flash_stored) { /* unicorn has stored the plain value: put back what the flash made of it */
		memcpy(e->flash + e->flash_patch, e->flash_bytes, 4);
		e->flash_stored = false;
		uc_ctl_flush_tlb(e->uc);
	}
}

/* What a first instruction in ITCM, or one in busy flash, must wait for. */
static void prepare_fetch(struct engine *e)
{
	if (e->s.pc < ITCM_BYTES)
		close_itcm(e);
	else if (e->s.flash_busy << FRACTION > e->s.time)
		e->s.time = e->next_due < e->s.flash_busy << FRACTION ? e->next_due : e->s.flash_busy << FRACTION;
}

static bool is_stalled(const struct engine *e)
{
	return e->s.pc >= ITCM_BYTES && e->s.flash_busy << FRACTION > e->s.time;
}

/* Runs until `cycle` (of 216 MHz) or for at most `instructions`. Returns an enum outcome. */
int engine_run(struct engine *e, uint64_t cycle, uint64_t instructions)
{
	e->until = cycle > NEVER >> FRACTION ? NEVER : cycle << FRACTION;
	e->limit = instructions > NEVER - e->s.instructions ? NEVER : e->s.instructions + instructions;
	e->at_breakpoint = false;
	for (;;) {
		if (e->failed)
			return RUN_FAILED;
		if (e->reset_wanted)
			return RUN_RESET;
		if (e->s.time >= e->until)
			return RUN_REACHED;
		fire_due(e);
		if (e->failed || e->reset_wanted)
			continue;
		if (e->s.sleeping) {
			if (wakes(e)) {
				e->s.sleeping = false;
			} else if (e->next_due == NEVER && e->until == NEVER) {
				return RUN_ASLEEP;
			} else {
				e->s.time = e->next_due < e->until ? e->next_due : e->until;
				continue;
			}
		}
		prepare_fetch(e);
		if (is_stalled(e) || e->next_due <= e->s.time)
			continue;
		const uint32_t exception = deliverable(e);
		if (exception != EXC_THREAD) {
			e->at_breakpoint = false;
			exception_enter(e, exception);
			continue;
		}
		if (e->at_breakpoint)
			return RUN_BREAKPOINT;
		if (e->s.instructions >= e->limit)
			return RUN_LIMIT;
		execute(e);
	}
}

/* ---- what Python calls ---- */

struct engine *engine_new(uint64_t cpi, bool strict, bool profiling, const uint16_t *function_of)
{
	struct engine *e = calloc(1, sizeof *e);

	if (e == NULL)
		return NULL;
	e->s.cpi = cpi;
	e->strict = strict;
	e->profiling = profiling;
	e->function_of = function_of;
	e->skip = NOWHERE;
	e->itcm = calloc(1, ITCM_BYTES);
	e->flash = malloc(FLASH_BYTES);
	e->system = malloc(SYSTEM_BYTES);
	e->ram = calloc(1, RAM_BYTES);
	e->blocks = calloc(CODE_HALFWORDS, sizeof *e->blocks);
	e->enters = calloc(CODE_HALFWORDS + 1u, sizeof *e->enters);
	e->leaves = calloc(CODE_HALFWORDS + 1u, sizeof *e->leaves);
	memset(e->flash, 0xFF, FLASH_BYTES);
	memset(e->system, 0xFF, SYSTEM_BYTES);
	memset(e->apb, 0xFF, sizeof e->apb);
	memset(e->ahb2, 0xFF, sizeof e->ahb2);
	memset(e->ppb, 0xFF, sizeof e->ppb);
	for (uint32_t i = 0; i < ALARM_MAX; ++i)
		e->s.due[i] = NEVER;
	return e;
}

/* Opens unicorn and maps the chip. 0, or unicorn's error. */
int engine_open(struct engine *e)
{
	const uint32_t code = UC_PROT_READ | UC_PROT_EXEC, data = UC_PROT_READ | UC_PROT_WRITE;
	uc_engine *uc;
	uc_hook hook;
	uc_err error = uc_open(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS, &e->uc);

	if (error != UC_ERR_OK)
		return (int)error;
	uc = e->uc;
	error = uc_ctl_set_cpu_model(uc, UC_CPU_ARM_CORTEX_M7);
	error = error ? error : uc_mem_map_ptr(uc, ITCM_BASE, ITCM_BYTES, UC_PROT_ALL, e->itcm);
	error = error ? error : uc_mem_map_ptr(uc, ALIAS_BASE, FLASH_BYTES, code, e->flash);
	error = error ? error : uc_mem_map_ptr(uc, FLASH_BASE, FLASH_BYTES, code, e->flash);
	error = error ? error : uc_mem_map_ptr(uc, SYSTEM_BASE, SYSTEM_BYTES, UC_PROT_READ, e->system);
	error = error ? error : uc_mem_map_ptr(uc, RAM_BASE, RAM_BYTES, data, e->ram);
	error = error ? error : uc_mmio_map(uc, APB_BASE, APB_BYTES, read_apb, e, write_apb, e);
	error = error ? error : uc_mmio_map(uc, AHB2_BASE, AHB2_BYTES, read_ahb2, e, write_ahb2, e);
	error = error ? error : uc_mmio_map(uc, PPB_BASE, PPB_BYTES, read_ppb, e, write_ppb, e);
	error = error ? error : uc_hook_add(uc, &hook, UC_HOOK_BLOCK, (void *)on_block, e, 1, 0);
	error = error ? error : uc_hook_add(uc, &hook, UC_HOOK_CODE, (void *)on_code, e, 1, 0);
	error = error ? error : uc_hook_add(uc, &hook, UC_HOOK_INTR, (void *)on_interrupt, e, 1, 0);
	error = error ? error : uc_hook_add(uc, &hook, UC_HOOK_MEM_INVALID, (void *)on_invalid, e, 1, 0);
	return (int)error;
}

void engine_free(struct engine *e)
{
	if (e->uc != NULL)
		uc_close(e->uc);
	for (uint32_t i = 0; i < CODE_HALFWORDS; ++i)
		block_free(e->blocks[i]);
	free(e->itcm);
	free(e->flash);
	free(e->system);
	free(e->ram);
	free(e->blocks);
	free(e->enters);
	free(e->leaves);
	free(e->nodes);
	free(e);
}

void engine_callbacks(struct engine *e, read_callback read, write_callback write, alarm_callback alarm,
		      flash_callback flash)
{
	e->on_read = read;
	e->on_write = write;
	e->on_alarm = alarm;
	e->on_flash = flash;
}

/* A system reset: registers as ARMv7-M B1.5.5 says, RAM as it is. The stack and the first instruction come from
 * `vectors`. Alarms and lines of peripherals are cancelled. */
void engine_reset(struct engine *e, uint32_t vectors)
{
	const uint8_t *const head = host(e, vectors, 8);
	uint32_t sp = 0, pc = 0;

	e->block = NULL;
	e->failed = e->reset_wanted = e->attention = false;
	exceptions_reset(e);
	system_reset_registers(e);
	e->s.vtor = vectors;
	e->s.sleeping = e->s.itcm_closed = false;
	e->s.flash_busy = 0;
	for (uint32_t i = 0; i < ALARM_MAX; ++i)
		e->s.due[i] = NEVER;
	uc_mem_protect(e->uc, ITCM_BASE, ITCM_BYTES, UC_PROT_ALL);
	forget_code(e);
	if (e->s.core_hz == 0u)
		e->s.core_hz = HSI_HZ;
	set_core_clock(e, HSI_HZ);
	for (int i = 0; i < 13; ++i)
		set_reg(e, general[i], 0xA5A5A5A5u); /* unknown on the chip */
	set_reg(e, UC_ARM_REG_XPSR, 1u << 24);
	set_reg(e, UC_ARM_REG_CONTROL, 0);
	set_reg(e, UC_ARM_REG_PRIMASK, 0);
	set_reg(e, UC_ARM_REG_BASEPRI, 0);
	set_reg(e, UC_ARM_REG_FAULTMASK, 0);
	set_reg(e, UC_ARM_REG_FPSCR, 0);
	if (head != NULL) {
		memcpy(&sp, head, 4);
		memcpy(&pc, head + 4, 4);
	}
	set_reg(e, UC_ARM_REG_SP, sp & ~3u);
	set_reg(e, UC_ARM_REG_LR, 0xFFFFFFFFu);
	e->s.pc = pc & ~1u;
	e->s.last_end = e->s.called = NOWHERE;
	e->s.node = 0;
	if (head == NULL || (pc & 1u) == 0u)
		fail(e, "no vectors at 0x%08X: stack 0x%08X, reset 0x%08X", vectors, sp, pc);
}

int engine_attach(struct engine *e, uint32_t base, uint32_t size)
{
	int16_t *pages = base - APB_BASE < APB_BYTES   ? &e->apb[(base - APB_BASE) >> 10] :
			 base - AHB2_BASE < AHB2_BYTES ? &e->ahb2[(base - AHB2_BASE) >> 10] :
			 base >= PPB_BASE && base - PPB_BASE < PPB_BYTES ? &e->ppb[(base - PPB_BASE) >> 10] :
									   NULL;

	if (pages == NULL || e->window_count == WINDOW_MAX || (base | size) & 0x3FFu)
		return -1;
	for (uint32_t i = 0; i < size >> 10; ++i)
		if (pages[i] >= 0)
			return -1;
	for (uint32_t i = 0; i < size >> 10; ++i)
		pages[i] = (int16_t)e->window_count;
	e->windows[e->window_count] = (struct window){.base = base, .size = size};
	return (int)e->window_count++;
}

int engine_new_alarm(struct engine *e)
{
	return e->alarm_count < ALARM_MAX ? (int)e->alarm_count++ : -1;
}

void engine_set_alarm(struct engine *e, uint32_t alarm, uint64_t cycle)
{
	e->s.due[alarm] = cycle > NEVER >> FRACTION ? NEVER : cycle;
	alarms_changed(e);
}

uint64_t engine_due(const struct engine *e, uint32_t alarm)
{
	return e->s.due[alarm];
}

uint64_t engine_cycle(const struct engine *e)
{
	return now(e) >> FRACTION;
}

void engine_irq(struct engine *e, uint32_t number, bool asserted)
{
	if (number < IRQ_COUNT)
		set_line(e, EXC_IRQ0 + number, asserted);
}

void engine_nmi(struct engine *e)
{
	pend(e, EXC_NMI);
}

/* A bus master's access: no check of alignment, no MPU. */
uint32_t engine_load(struct engine *e, uint32_t address, uint32_t size)
{
	const uint8_t *const memory = host(e, address, size);
	uint32_t value = 0;

	if (memory == NULL)
		return device_read(e, address, size);
	memcpy(&value, memory, size);
	return value;
}

void engine_store(struct engine *e, uint32_t address, uint32_t size, uint32_t value)
{
	if (inside(address, size, RAM_BASE, RAM_BYTES))
		memcpy(e->ram + (address - RAM_BASE), &value, size);
	else if (host(e, address, size) != NULL)
		fail(e, "a bus master writes 0x%X (%u bytes) to 0x%08X, which it cannot", value, size, address);
	else
		device_write(e, address, size, value);
}

uint8_t *engine_memory(struct engine *e, uint32_t address, uint32_t size)
{
	return host(e, address, size);
}

/* Changes memory as a bus master of its own. Flash is changed from within a store to it, too. */
int engine_poke(struct engine *e, uint32_t address, const uint8_t *data, uint32_t size)
{
	uint8_t *const memory = host(e, address, size);

	if (memory == NULL)
		return -1;
	memcpy(memory, data, size);
	if (row_of(address) != NOWHERE) {
		e->code_changed = true;
		look_again(e);
	}
	return 0;
}

void engine_core_clock(struct engine *e, uint64_t hz)
{
	set_core_clock(e, hz);
}

void engine_flash_busy(struct engine *e, uint64_t until)
{
	e->s.flash_busy = until > NEVER >> FRACTION ? NEVER >> FRACTION : until;
	look_again(e);
}

void engine_want_reset(struct engine *e)
{
	e->reset_wanted = true;
	look_again(e);
}

/* A callback has failed; the message is Python's own. */
void engine_fail(struct engine *e)
{
	fail(e, "%s", "");
}

const char *engine_message(const struct engine *e)
{
	return e->message;
}

/* Where the program is: in a callback the instruction at hand, after a failure the one that failed. */
uint32_t engine_pc(const struct engine *e)
{
	return e->failed ? e->last_pc : e->block != NULL ? e->at : e->s.pc;
}

void engine_set_pc(struct engine *e, uint32_t pc)
{
	e->s.pc = pc & ~1u;
	e->s.last_end = NOWHERE;
}

uint32_t engine_register(struct engine *e, int name)
{
	return reg(e, name);
}

void engine_set_register(struct engine *e, int name, uint32_t value)
{
	set_reg(e, name, value);
}

struct state *engine_state(struct engine *e)
{
	return &e->s;
}

uint32_t engine_state_bytes(void)
{
	return sizeof(struct state);
}

/* After `engine_state` has been overwritten. */
void engine_restored(struct engine *e)
{
	e->block = NULL;
	e->failed = e->reset_wanted = false;
	e->skip = NOWHERE;
	forget_code(e);
	uc_mem_protect(e->uc, ITCM_BASE, ITCM_BYTES, e->s.itcm_closed ? UC_PROT_READ | UC_PROT_EXEC : UC_PROT_ALL);
	if (e->s.node >= e->node_count)
		e->s.node = 0;
	alarms_changed(e);
}

uint64_t engine_instructions(const struct engine *e)
{
	return e->s.instructions;
}

uint64_t engine_hash(const struct engine *e)
{
	return e->s.hash;
}

bool engine_cached(const struct engine *e, uint32_t address)
{
	return data_is_cached(e, address);
}

/* A request of `exception` that waits longer than `cycles` (of 216 MHz) is an error; 0: it may wait. */
void engine_bound_entry(struct engine *e, uint32_t exception, uint64_t cycles)
{
	if (exception < EXCEPTION_COUNT)
		e->entry_bound[exception] = cycles << FRACTION;
}

uint32_t engine_depth(const struct engine *e)
{
	return e->s.depth;
}

bool engine_sleeping(const struct engine *e)
{
	return e->s.sleeping;
}

const struct task *engine_task(const struct engine *e, uint32_t exception)
{
	return &e->s.tasks[exception];
}

uint64_t *engine_enters(struct engine *e)
{
	count_all(e);
	return e->enters;
}

uint64_t *engine_leaves(struct engine *e)
{
	count_all(e);
	return e->leaves;
}

const struct window *engine_window(const struct engine *e, uint32_t window)
{
	return &e->windows[window];
}

int engine_set_breakpoints(struct engine *e, const uint32_t *addresses, uint32_t count)
{
	if (count > BREAKPOINT_MAX)
		return -1;
	memcpy(e->breakpoints, addresses, count * sizeof *addresses);
	e->breakpoint_count = count;
	look_again(e);
	return 0;
}

/* The breakpoint at the program counter is run over once. */
void engine_skip_breakpoint(struct engine *e)
{
	e->skip = e->s.pc;
}

const struct node *engine_nodes(const struct engine *e, uint32_t *count)
{
	*count = e->node_count;
	return e->nodes;
}
