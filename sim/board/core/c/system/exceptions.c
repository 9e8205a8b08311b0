/* Exceptions of the ARMv7-M core (DDI 0403E B1.5): priorities, entry, return, tail-chaining, faults. */
#include <stdio.h>
#include <string.h>

#include "../base/machine.h"
#include "../code/code.h"
#include "system.h"

enum {
	STACKED_ALIGN = 1u << 9, /* of the stacked xPSR: a word was left out to align the frame */
	CONTROL_SPSEL = 1u << 1,
	CONTROL_FPCA = 1u << 2,
	CONTROL_FLOATS = 3u << 2, /* unicorn's core begins in ARMv8-M's secure state and wants SFPA beside FPCA */
	FRAME_BYTES = 0x20,
	FLOAT_BYTES = 0x48,
	THREAD_PRIORITY = 256,
	/* Cycles of the core beside the instructions (Cortex-M7 TRM 3.9.2: 12 from request to handler with memory
	 * that does not wait); return and tail-chain as ARM states for the family. */
	ENTRY_CYCLES = 12,
	RETURN_CYCLES = 10,
	CHAIN_CYCLES = 6,
	REPEATS_MAX = 1000,
};

#define SHCSR_MEMFAULTENA (1u << 16)
#define SHCSR_BUSFAULTENA (1u << 17)
#define SHCSR_USGFAULTENA (1u << 18)
#define HFSR_FORCED (1u << 30)
#define CFSR_MMARVALID (1u << 7)
#define CFSR_BFARVALID (1u << 15)
#define CFSR_MSTKERR (1u << 4)
#define CFSR_STKERR (1u << 12)
#define CFSR_UNSTKERR (1u << 11)

/* Priority by which one exception may interrupt another: the upper bits, as AIRCR.PRIGROUP cuts them. */
static int exceptions_group(const struct engine *e, uint32_t priority)
{
	const uint32_t split = (e->s.aircr >> 8 & 7u) + 1u;

	return (int)(priority >> split << split);
}

/* -3 of a reset, -2 of an NMI, -1 of a hard fault; all others have a register. */
static int exceptions_own_priority(const struct engine *e, uint32_t exception)
{
	return exception >= EXC_RESET && exception <= EXC_HARD ? (int)exception - 4 : e->s.priority[exception];
}

static int exceptions_group_priority(const struct engine *e, uint32_t exception)
{
	const int own = exceptions_own_priority(e, exception);

	return own < 0 ? own : exceptions_group(e, (uint32_t)own);
}

bool exceptions_preempts(const struct engine *e, uint32_t exception, uint32_t other)
{
	return exceptions_group_priority(e, exception) < exceptions_group_priority(e, other);
}

/* B1.5.4; `with_primask` false: as WFI sees it. */
int exceptions_priority(struct engine *e, bool with_primask)
{
	int priority = THREAD_PRIORITY;

	for (uint32_t i = 1; i <= e->s.depth; ++i) {
		const int one = exceptions_group_priority(e, e->s.active[i].exception);

		if (one < priority)
			priority = one;
	}
	const uint32_t base = reg(e, UC_ARM_REG_BASEPRI) & 0xF0u;
	if (base != 0u && exceptions_group(e, base) < priority)
		priority = exceptions_group(e, base);
	if (with_primask && reg(e, UC_ARM_REG_PRIMASK) & 1u && priority > 0)
		priority = 0;
	if (reg(e, UC_ARM_REG_FAULTMASK) & 1u && priority > -1)
		priority = -1;
	return priority;
}

/* The pending and enabled exception that goes first: lowest priority value, then lowest number. */
uint32_t exceptions_first_pending(const struct engine *e)
{
	uint32_t found = EXC_THREAD;

	for (uint32_t word = 0; word < 2u; ++word)
		for (uint64_t left = e->s.pending.words[word] & e->s.enabled.words[word]; left != 0u; left &= left - 1u) {
			const uint32_t i = word * 64u + (uint32_t)__builtin_ctzll(left);

			if (found == EXC_THREAD || exceptions_own_priority(e, i) < exceptions_own_priority(e, found))
				found = i;
		}
	return found;
}

uint32_t exceptions_deliverable(struct engine *e)
{
	const uint32_t found = exceptions_first_pending(e);

	return found != EXC_THREAD && exceptions_group_priority(e, found) < exceptions_priority(e, true) ? found : EXC_THREAD;
}

bool exceptions_wake(struct engine *e)
{
	const uint32_t found = exceptions_first_pending(e);

	return found != EXC_THREAD && exceptions_group_priority(e, found) < exceptions_priority(e, false);
}

void exceptions_reset(struct engine *e)
{
	static const uint8_t always[] = {EXC_NMI, EXC_HARD, EXC_MEM, EXC_BUS, EXC_USAGE, EXC_SVC, EXC_PENDSV, EXC_SYSTICK};

	e->s.pending = e->s.is_active = e->s.enabled = e->s.line = (struct flags){0};
	memset(e->s.priority, 0, sizeof e->s.priority);
	for (uint32_t i = 0; i < sizeof always; ++i)
		put(&e->s.enabled, always[i], true);
	e->s.depth = 0;
	e->s.active[0].exception = EXC_THREAD;
}

void exceptions_pend(struct engine *e, uint32_t exception)
{
	if (!get(&e->s.pending, exception)) {
		put(&e->s.pending, exception, true);
		e->s.pended_at[exception] = clock_now(e);
		e->s.pended_pc[exception] = e->block == NULL ? e->s.pc : e->at;
		e->s.pended_in[exception] = (uint8_t)e->s.active[e->s.depth].exception;
	}
	clock_attend(e);
}

/* A line that is high makes its interrupt pending when it rises and again when its handler ends. */
void exceptions_set_line(struct engine *e, uint32_t exception, bool asserted)
{
	const bool rises = asserted && !get(&e->s.line, exception);

	put(&e->s.line, exception, asserted);
	if (rises)
		exceptions_pend(e, exception);
}

static void exceptions_stacking_failed(struct engine *e, uint32_t sp, uint32_t cfsr, const char *what)
{
	struct fault fault = {.exception = EXC_BUS, .cfsr = cfsr, .address = sp};

	snprintf(fault.text, sizeof fault.text, "stack overflow: %s at 0x%08X lies outside RAM", what, sp);
	exceptions_raise(e, &fault);
}

static bool exceptions_is_ram(uint32_t address, uint32_t size)
{
	return address >= RAM_BASE && address - RAM_BASE <= RAM_BYTES - size;
}

/* Words of a frame: six registers, PC, xPSR; then S0 to S15, FPSCR and a word that is reserved. */
enum { FRAME_PC = 6, FRAME_PSR = 7, FRAME_FLOATS = 8, FRAME_FPSCR = 24, FRAME_WORDS = 26 };
static const int frame_registers[] = {
	UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3, UC_ARM_REG_R12, UC_ARM_REG_LR,
};

/* B1.5.6 PushStack. The floating-point part is saved at once: LSPACT never shows. Returns EXC_RETURN, 0: failed. */
static uint32_t exceptions_push_frame(struct engine *e)
{
	const uint32_t control = reg(e, UC_ARM_REG_CONTROL), psr = reg(e, UC_ARM_REG_XPSR);
	const bool floats = control & CONTROL_FPCA, handler = e->s.depth != 0u;
	const bool process = !handler && control & CONTROL_SPSEL;
	const uint32_t size = FRAME_BYTES + (floats ? FLOAT_BYTES : 0u);
	const uint32_t before = reg(e, UC_ARM_REG_SP);
	const uint32_t sp = (before - size) & ~7u;
	const uint32_t padded = before - size != sp ? STACKED_ALIGN : 0u;
	uint32_t frame[FRAME_WORDS] = {
		[FRAME_PC] = e->s.pc & ~1u, [FRAME_PSR] = (psr & ~(uint32_t)STACKED_ALIGN) | padded};

	if (!exceptions_is_ram(sp, size)) {
		exceptions_stacking_failed(e, sp, CFSR_STKERR, "an exception frame");
		return 0;
	}
	for (uint32_t i = 0; i < FRAME_PC; ++i)
		frame[i] = reg(e, frame_registers[i]);
	for (int i = 0; floats && i < 16; ++i)
		frame[FRAME_FLOATS + i] = reg(e, UC_ARM_REG_S0 + i);
	if (floats) {
		frame[FRAME_FPSCR] = reg(e, UC_ARM_REG_FPSCR);
		e->s.fpcar = sp + FRAME_BYTES;
	}
	memcpy(e->ram + (sp - RAM_BASE), frame, size);
	set_reg(e, UC_ARM_REG_SP, sp);
	return (floats ? 0xFFFFFFE1u : 0xFFFFFFF1u) | (handler ? 0u : 8u) | (process ? 4u : 0u);
}

static uint64_t exceptions_time_of(const struct state *s, uint64_t cycles)
{
	return (cycles * TIME_HZ << FRACTION) / s->core_hz;
}

static double exceptions_us(uint64_t time)
{
	return (double)(time >> FRACTION) * 1e6 / (double)TIME_HZ;
}

/* A request has waited: fails beyond its bound. Masking interrupts while flash is erased or programmed is allowed, but
 * not to code in flash, which is stalled for as long. */
static void exceptions_check_wait(struct engine *e, uint32_t exception, uint64_t waited)
{
	const struct state *s = &e->s;
	const uint64_t bound = e->entry_bound[exception], since = s->pended_at[exception];
	const uint32_t in = s->pended_in[exception];
	const bool stalled = s->stalled != 0u && s->stalled >= since;
	char why[48] = "interrupts were masked";

	if (bound == 0u || waited <= bound || (!stalled && s->flash_rested << FRACTION > since))
		return;
	if (stalled)
		snprintf(why, sizeof why, "the core waited for busy flash");
	else if (in != EXC_THREAD && exceptions_group_priority(e, in) <= exceptions_group_priority(e, exception))
		snprintf(why, sizeof why, "the handler of exception %u ran", in);
	fail(e, "%s waited %.2f us for its handler, at most %.2f us are allowed: %s", e->bound_name[exception], exceptions_us(waited),
	     exceptions_us(bound), why);
	e->last_pc = s->pended_pc[exception];
}

/* Goes to the handler's first instruction, sets IPSR, and counts. */
static void exceptions_take(struct engine *e, uint32_t exception, uint32_t exc_return, uint32_t cycles)
{
	struct state *s = &e->s;
	const uint8_t *entry = host(e, s->vtor + 4u * exception, 4);
	uint32_t vector = 0;

	if (entry != NULL)
		memcpy(&vector, entry, 4);
	if ((vector & 1u) == 0u) {
		if (vector == 0u)
			fail(e, "exception %u has no vector at 0x%08X", exception, s->vtor + 4u * exception);
		else
			fail(e, "vector 0x%08X of exception %u is no Thumb address", vector, exception);
		return;
	}
	/* Handler mode first: it selects the main stack, whatever CONTROL says. */
	set_reg(e, UC_ARM_REG_XPSR, (reg(e, UC_ARM_REG_XPSR) & 0xF80F0000u) | XPSR_THUMB | exception);
	set_reg(e, UC_ARM_REG_CONTROL, reg(e, UC_ARM_REG_CONTROL) & CONTROL_SPSEL);
	set_reg(e, UC_ARM_REG_LR, exc_return);
	put(&s->pending, exception, false);
	put(&s->is_active, exception, true);

	struct task *task = &s->tasks[exception];
	const uint64_t waited = s->time > s->pended_at[exception] ? s->time - s->pended_at[exception] : 0;
	if (waited > task->latest) {
		task->latest = waited;
		task->latest_at = s->time;
		task->latest_pc = s->pc;
	}
	exceptions_check_wait(e, exception, waited);
	s->time += exceptions_time_of(s, cycles);
	++task->activations;
	++s->depth;
	s->active[s->depth] = (struct activation){
		.exception = exception,
		.node = s->node, .called = s->called, .entered = s->instructions, .time = s->time};
	s->pc = vector & ~1u;
	s->last_end = NOWHERE;
	engine_mix(&e->s, (uint64_t)exception << 32 | vector);
	engine_mix(&e->s, s->time);
	profile_enter(e);
}

void exceptions_enter(struct engine *e, uint32_t exception)
{
	const uint32_t exc_return = exceptions_push_frame(e);

	if (exc_return != 0u)
		exceptions_take(e, exception, exc_return, ENTRY_CYCLES);
}

static void exceptions_close(struct engine *e)
{
	struct state *s = &e->s;
	const struct activation *a = &s->active[s->depth];
	struct task *task = &s->tasks[a->exception];
	const uint64_t all = s->instructions - a->entered, own = all - a->preempted;

	task->instructions += own;
	if (task->least == 0u || own < task->least)
		task->least = own;
	if (own > task->most)
		task->most = own;
	if (s->time - a->time > task->longest)
		task->longest = s->time - a->time;
	s->node = a->node;
	s->called = a->called;
	put(&s->is_active, a->exception, false);
	--s->depth;
	s->active[s->depth].preempted += all;
	if (get(&s->line, a->exception))
		exceptions_pend(e, a->exception);
}

/* B1.5.8 PopStack. */
static void exceptions_pop_frame(struct engine *e, uint32_t exc_return)
{
	const bool floats = (exc_return & 0x10u) == 0u, thread = exc_return & 8u, process = exc_return & 4u;
	const uint32_t size = FRAME_BYTES + (floats ? FLOAT_BYTES : 0u);
	const uint32_t sp = reg(e, process ? UC_ARM_REG_PSP : UC_ARM_REG_MSP);
	uint32_t frame[FRAME_WORDS];

	if (!exceptions_is_ram(sp, size)) {
		exceptions_stacking_failed(e, sp, CFSR_UNSTKERR, "the exception frame to return to");
		return;
	}
	memcpy(frame, e->ram + (sp - RAM_BASE), size);
	const uint32_t psr = frame[FRAME_PSR], pc = frame[FRAME_PC];
	const uint32_t after = sp + size + (psr & STACKED_ALIGN ? 4u : 0u);
	if (((psr & 0x1FFu) == 0u) != thread || (psr & XPSR_THUMB) == 0u || pc & 1u) {
		fail(e, "exception return 0x%08X to pc 0x%08X with xPSR 0x%08X, which do not belong together", exc_return,
		     pc, psr);
		return;
	}
	set_reg(e, process ? UC_ARM_REG_PSP : UC_ARM_REG_MSP, after);
	set_reg(e, UC_ARM_REG_XPSR, psr & 0xF90F01FFu);
	set_reg(e, UC_ARM_REG_CONTROL, (floats ? CONTROL_FLOATS : 0u) | (thread && process ? CONTROL_SPSEL : 0u));
	for (uint32_t i = 0; i < FRAME_PC; ++i)
		set_reg(e, frame_registers[i], frame[i]);
	for (int i = 0; floats && i < 16; ++i)
		set_reg(e, UC_ARM_REG_S0 + i, frame[FRAME_FLOATS + i]);
	if (floats)
		set_reg(e, UC_ARM_REG_FPSCR, frame[FRAME_FPSCR]);
	e->s.pc = pc;
	e->s.last_end = NOWHERE;
	engine_mix(&e->s, (uint64_t)exc_return << 32 | pc);
}

void exceptions_return(struct engine *e, uint32_t exc_return)
{
	struct state *s = &e->s;
	const uint32_t kind = exc_return & 0xFu;

	const uint32_t ended = s->active[s->depth].exception;

	if (s->depth == 0u) {
		fail(e, "a branch to 0x%08X outside a handler", exc_return);
	} else if ((exc_return & 0xFFFFFFE0u) != 0xFFFFFFE0u || (kind != 1u && kind != 9u && kind != 13u) ||
		   (kind == 1u) != (s->depth > 1u)) {
		fail(e, "exception return by 0x%08X with %u exceptions active", exc_return, s->depth);
	}
	if (e->failed) {
		e->last_pc = s->last_end - 2u;
		return;
	}
	if (ended != EXC_NMI)
		set_reg(e, UC_ARM_REG_FAULTMASK, 0);
	exceptions_close(e);
	/* Tail-chaining: the next handler finds the frame as it lies. */
	const uint32_t next = exceptions_deliverable(e);
	s->repeats = next == ended && get(&s->line, ended) ? s->repeats + 1u : 0;
	if (s->repeats >= REPEATS_MAX) {
		fail(e, "the handler of exception %u has run %u times in a row and leaves its request up", ended, s->repeats);
		e->last_pc = s->last_end - 2u;
		return;
	}
	if (next != EXC_THREAD) {
		s->pc = exc_return;
		exceptions_take(e, next, exc_return, CHAIN_CYCLES);
		return;
	}
	exceptions_pop_frame(e, exc_return);
	s->time += exceptions_time_of(s, RETURN_CYCLES);
	if (s->depth == 0u && s->scr & 2u)
		s->sleeping = true;
}

/* Strict: an error of the image. Else the exception, or the hard fault when it may not be taken (B1.5.14). */
void exceptions_raise(struct engine *e, const struct fault *fault)
{
	struct state *s = &e->s;
	uint32_t exception = fault->exception;

	if (e->strict) {
		fail(e, "%s", fault->text);
		if (fault->jumped && s->last_end != NOWHERE)
			e->last_pc = s->last_end - 2u;
		return;
	}
	s->cfsr |= fault->cfsr;
	s->hfsr |= fault->hfsr;
	if (fault->has_address && exception == EXC_MEM) {
		s->mmfar = fault->address;
		s->cfsr |= CFSR_MMARVALID;
	} else if (fault->has_address) {
		s->bfar = fault->address;
		s->cfsr |= CFSR_BFARVALID;
	}
	const bool on = exception == EXC_MEM   ? s->shcsr & SHCSR_MEMFAULTENA :
			exception == EXC_BUS   ? s->shcsr & SHCSR_BUSFAULTENA :
			exception == EXC_USAGE ? s->shcsr & SHCSR_USGFAULTENA :
						 true;
	const int current = exceptions_priority(e, true);
	if (!on || exceptions_group_priority(e, exception) >= current) {
		exception = EXC_HARD;
		s->hfsr |= HFSR_FORCED;
		if (current <= -1) {
			fail(e, "lockup, a fault within a fault handler: %s", fault->text);
			return;
		}
	}
	/* The frame that did not fit is lost; the handler runs on what is left of the stack, as on the chip. */
	if (fault->cfsr & (CFSR_STKERR | CFSR_UNSTKERR | CFSR_MSTKERR)) {
		fail(e, "%s", fault->text);
		return;
	}
	s->pended_at[exception] = s->time;
	exceptions_enter(e, exception);
}
