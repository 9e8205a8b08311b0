/* The loop: unicorn executes until something is due; then the engine takes the exception, raises the fault, or sleeps. */
#include <stdio.h>
#include <string.h>

#include "../base/machine.h"
#include "../code/code.h"
#include "../system/system.h"
#include "hooks.h"

#define BLOCK_ADDRESSES_END 0xFFFFFFFFu /* unicorn wants an address to stop at: an odd one is never reached */

/* Unicorn's numbers. */
enum { INTERRUPT_SVC = 2, INTERRUPT_PREFETCH = 3, INTERRUPT_BKPT = 7, INTERRUPT_EXCEPTION_RETURN = 8 };

/* Alarms and SysTick when they are due. */
static void run_fire(struct engine *e)
{
	while (!e->failed && e->next_due <= e->s.time) {
		uint64_t first = clock_systick_due(e);
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
			const uint64_t began = clock_host_ns(e);

			e->callbacks.alarm(e->callbacks.user, which);
			e->spent[SPENT_DEVICES] += clock_host_ns(e) - began;
		}
		clock_alarms_changed(e);
	}
}

/* What unicorn could not go on with becomes a fault of the core. `e->s.pc` stands on the instruction. */
static void run_explain(struct engine *e, uc_err error)
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
				    e->flash_stored          ? "the second store to flash by one instruction" :
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
		f->jumped = true;
		snprintf(f->text, sizeof f->text, "execution at 0x%08X, %s", e->s.pc,
			 error == UC_ERR_FETCH_PROT ? "in RAM; code runs from flash and ITCM" : "where nothing is");
		break;
	case UC_ERR_INSN_INVALID:
		f->exception = EXC_USAGE;
		f->has_address = false;
		f->jumped = (reg(e, UC_ARM_REG_XPSR) & XPSR_THUMB) == 0u;
		f->cfsr = f->jumped ? FAULT_STATE : FAULT_UNDEFINED;
		if (f->jumped)
			snprintf(f->text, sizeof f->text, "a branch to 0x%08X, which is no Thumb address", e->s.pc);
		else
			snprintf(f->text, sizeof f->text, "undefined instruction");
		break;
	default:
		f->exception = EXC_THREAD;
		fail(e, "the processor's model stopped: %s", uc_strerror(error));
	}
}

static void run_supervisor_call(struct engine *e)
{
	const struct fault escalated = {
		.exception = EXC_HARD, .hfsr = 1u << 30, .text = "SVC where its priority does not let it run"};

	e->s.pended_at[EXC_SVC] = e->s.time;
	if (exceptions_priority(e, true) > e->s.priority[EXC_SVC])
		exceptions_enter(e, EXC_SVC);
	else
		exceptions_raise(e, &escalated);
}

/* YIELD and WFE, which unicorn does not know what to do with: a program may go on behind them (B1.5.18). */
static bool run_is_hint(struct engine *e, uint32_t address)
{
	const uint8_t *const code = host(e, address, 2);

	return code != NULL && code[1] == 0xBFu && (code[0] == 0x10u || code[0] == 0x20u);
}

static bool run_is_rom(uint32_t address)
{
	return inside(address, 2, SYSTEM_BASE, SYSTEM_BYTES) || inside(address, 2, SYSTEM_ALIAS_BASE, SYSTEM_BYTES);
}

/* Unicorn has come back by itself or because of us. */
static void run_settle(struct engine *e, uc_err error)
{
	const bool fetch = error == UC_ERR_FETCH_UNMAPPED || error == UC_ERR_FETCH_PROT;

	if (e->stopped) { /* hooks_leave() has counted */
		if (e->fault.exception != EXC_THREAD)
			exceptions_raise(e, &e->fault);
		return;
	}
	e->s.pc = reg(e, UC_ARM_REG_PC);
	if (e->block != NULL) {
		const bool whole = error == UC_ERR_OK || fetch;

		if (error == UC_ERR_INSN_INVALID && run_is_hint(e, e->at)) {
			e->s.pc = e->at + 2u;
			hooks_account(e, clock_index_at(e, e->at) + 1u);
			return;
		}

		if (!whole)
			e->s.pc = e->at;
		hooks_account(e, whole ? e->block->count : clock_index_at(e, e->at));
	}
	if (e->failed)
		return;
	if (e->interrupt == INTERRUPT_PREFETCH)
		error = UC_ERR_FETCH_UNMAPPED;
	if (error != UC_ERR_OK && run_is_rom(e->s.pc))
		return; /* a jump into the ROM: the loop finds it there */
	if (error != UC_ERR_OK) {
		run_explain(e, error);
		if (!e->failed)
			exceptions_raise(e, &e->fault);
	} else if (e->interrupt == INTERRUPT_SVC) {
		run_supervisor_call(e);
	} else if (e->interrupt == INTERRUPT_EXCEPTION_RETURN) {
		exceptions_return(e, e->s.pc | 1u);
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

static void run_execute(struct engine *e)
{
	if (e->code_changed)
		blocks_forget(e);
	e->block = NULL;
	e->control_in = 0;
	e->stopped = e->waiting = e->flash_stored = false;
	e->interrupt = UINT32_MAX;
	e->fault.exception = EXC_THREAD;
	const uint64_t began = clock_host_ns(e), devices = e->spent[SPENT_DEVICES];
	const uc_err error = uc_emu_start(e->uc, e->s.pc | 1u, BLOCK_ADDRESSES_END, 0, 0);

	e->spent[SPENT_CODE] += clock_host_ns(e) - began - (e->spent[SPENT_DEVICES] - devices);
	run_settle(e, error);
	if (e->code_changed)
		blocks_forget(e);
	if (e->flash_stored) { /* unicorn has stored the plain value: put back what the flash made of it */
		memcpy(e->flash + e->flash_patch, e->flash_bytes, 4);
		e->flash_stored = false;
		uc_ctl_flush_tlb(e->uc);
	}
}

/* What a first instruction in ITCM, or one in busy flash, must wait for. */
static void run_prepare_fetch(struct engine *e)
{
	if (e->s.pc < ITCM_BYTES) {
		hooks_close_itcm(e);
	} else if (e->s.flash_busy << FRACTION > e->s.time) {
		e->s.time = e->s.flash_busy << FRACTION;
		e->s.time = e->next_due < e->s.time ? e->next_due : e->s.time;
		e->s.time = e->until < e->s.time ? e->until : e->s.time;
		e->s.stalled = e->s.time;
	}
}

static bool run_is_stalled(const struct engine *e)
{
	return e->s.pc >= ITCM_BYTES && e->s.flash_busy << FRACTION > e->s.time;
}

/* The core sleeps until something is due. An error is told at the instruction that sent it to sleep. */
static void run_pass_asleep(struct engine *e)
{
	const uint8_t *const before = host(e, e->s.pc - 2u, 2);

	if (e->callbacks.sleep != NULL)
		e->callbacks.sleep(e->callbacks.user);
	if (!e->failed)
		e->s.time = e->next_due < e->until ? e->next_due : e->until;
	else if (before != NULL && before[0] == 0x30u && before[1] == 0xBFu)
		e->last_pc = e->s.pc - 2u;
}

/* The program in the ROM is its maker's and not at hand: a callback is told that it begins and acts for it by alarms, while
 * time passes from one to the next. It uses no interrupt. Returns false once nothing more can happen. */
static bool run_rom(struct engine *e)
{
	if (!e->s.in_rom) {
		e->s.in_rom = true;
		e->s.sleeping = false;
		if (e->callbacks.rom == NULL)
			fail(e, "execution at 0x%08X, in a system memory that is empty", e->s.pc);
		else
			e->callbacks.rom(e->callbacks.user);
		return true;
	}
	if (e->next_due == NEVER && e->until == NEVER)
		return false;
	run_pass_asleep(e);
	return true;
}

int engine_run(struct engine *e, uint64_t cycle, uint64_t instructions)
{
	e->until = cycle > NEVER >> FRACTION ? NEVER : cycle << FRACTION;
	e->limit = instructions > NEVER - e->s.instructions ? NEVER : e->s.instructions + instructions;
	e->at_breakpoint = e->at_watchpoint = false;
	for (;;) {
		if (e->failed)
			return RUN_FAILED;
		if (e->reset_wanted)
			return RUN_RESET;
		if (e->s.time >= e->until)
			return RUN_REACHED;
		run_fire(e);
		if (e->failed || e->reset_wanted)
			continue;
		if (run_is_rom(e->s.pc)) {
			if (!run_rom(e))
				return RUN_ASLEEP;
			if (e->limit != NEVER)
				return RUN_LIMIT; /* a debugger counts instructions, of which there are none */
			continue;
		}
		if (e->s.sleeping) {
			if (exceptions_wake(e)) {
				e->s.sleeping = false;
			} else if (e->next_due == NEVER && e->until == NEVER) {
				return RUN_ASLEEP;
			} else {
				run_pass_asleep(e);
				continue;
			}
		}
		run_prepare_fetch(e);
		if (run_is_stalled(e) || e->next_due <= e->s.time || e->s.time >= e->until)
			continue;
		const uint32_t exception = exceptions_deliverable(e);
		if (exception != EXC_THREAD) {
			e->at_breakpoint = e->at_watchpoint = false;
			exceptions_enter(e, exception);
			continue;
		}
		if (e->at_breakpoint)
			return RUN_BREAKPOINT;
		if (e->at_watchpoint || e->watch_passed) {
			e->watch_passed = false;
			return RUN_WATCHPOINT;
		}
		if (e->s.instructions >= e->limit)
			return RUN_LIMIT;
		run_execute(e);
	}
}
