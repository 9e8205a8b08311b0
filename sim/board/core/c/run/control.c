/* The engine from outside: made, freed, reset; what peripherals and bus masters do to it. */
#include <stdlib.h>
#include <string.h>

#include "../base/machine.h"
#include "../code/code.h"
#include "../system/system.h"
#include "hooks.h"

#define HSI_HZ UINT64_C(16000000) /* the core's clock after reset (RM0431 5.2) */

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
	e->to_device = calloc(CODE_HALFWORDS, sizeof *e->to_device);
	memset(e->flash, 0xFF, FLASH_BYTES);
	memset(e->system, 0xFF, SYSTEM_BYTES);
	memset(e->apb, 0xFF, sizeof e->apb);
	memset(e->ahb2, 0xFF, sizeof e->ahb2);
	memset(e->ppb, 0xFF, sizeof e->ppb);
	for (uint32_t i = 0; i < ALARM_MAX; ++i)
		e->s.due[i] = NEVER;
	return e;
}

int engine_open(struct engine *e)
{
	uc_err error = uc_open(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS, &e->uc);

	error = error ? error : uc_ctl_set_cpu_model(e->uc, UC_CPU_ARM_CORTEX_M7);
	error = error ? error : windows_map(e);
	return (int)(error ? error : hooks_add(e));
}

void engine_free(struct engine *e)
{
	if (e->uc != NULL)
		uc_close(e->uc);
	for (uint32_t i = 0; i < CODE_HALFWORDS; ++i)
		blocks_drop(e, i);
	free(e->itcm);
	free(e->flash);
	free(e->system);
	free(e->ram);
	free(e->blocks);
	free(e->enters);
	free(e->leaves);
	free(e->to_device);
	free(e->nodes);
	free(e);
}

void engine_callbacks(struct engine *e, const struct callbacks *callbacks)
{
	e->callbacks = *callbacks;
}

void engine_reset(struct engine *e, uint32_t vectors)
{
	const uint8_t *const head = host(e, vectors, 8);
	uint32_t sp = 0, pc = 0;

	e->block = NULL;
	e->failed = e->reset_wanted = e->attention = false;
	e->watch_passed = false;
	e->skip = NOWHERE;
	exceptions_reset(e);
	system_reset_registers(e);
	e->s.vtor = vectors;
	e->s.sleeping = e->s.itcm_closed = e->s.in_rom = false;
	e->s.flash_busy = e->s.flash_rested = e->s.stalled = 0;
	for (uint32_t i = 0; i < ALARM_MAX; ++i)
		e->s.due[i] = NEVER;
	uc_mem_protect(e->uc, ITCM_BASE, ITCM_BYTES, UC_PROT_ALL);
	blocks_forget(e);
	if (e->s.core_hz == 0u)
		e->s.core_hz = HSI_HZ;
	clock_set_core(e, HSI_HZ);
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
	int16_t *pages = NULL;

	if (inside(base, size, APB_BASE, APB_BYTES))
		pages = &e->apb[(base - APB_BASE) >> 10];
	else if (inside(base, size, AHB2_BASE, AHB2_BYTES))
		pages = &e->ahb2[(base - AHB2_BASE) >> 10];
	else if (inside(base, size, PPB_BASE, PPB_BYTES))
		pages = &e->ppb[(base - PPB_BASE) >> 10];
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

int engine_new_answer(struct engine *e, uint32_t address)
{
	const int window = windows_at(e, address);

	if (e->answer_count == ANSWER_MAX || window < 0)
		return -1;
	e->windows[window].answers = true;
	e->answers[e->answer_count] = (struct answer){.address = address};
	return (int)e->answer_count++;
}

void engine_answer(struct engine *e, uint32_t answer, uint32_t value)
{
	e->answers[answer].value = value;
	e->answers[answer].generation = e->answers_generation + 1u;
}

void engine_forget_answers(struct engine *e)
{
	++e->answers_generation;
}

uint64_t engine_answered(struct engine *e, uint32_t answer)
{
	const uint64_t reads = e->answers[answer].reads;

	e->answers[answer].reads = 0;
	return reads;
}

int engine_new_alarm(struct engine *e)
{
	return e->alarm_count < ALARM_MAX ? (int)e->alarm_count++ : -1;
}

void engine_set_alarm(struct engine *e, uint32_t alarm, uint64_t cycle)
{
	const uint64_t before = e->s.due[alarm], after = cycle > NEVER >> FRACTION ? NEVER : cycle;

	e->s.due[alarm] = after;
	/* Most alarms are set again and again behind the one that comes first. */
	if (before == after || (before != NEVER && before << FRACTION <= e->next_due) ||
	    (after != NEVER && after << FRACTION < e->next_due))
		clock_alarms_changed(e);
}

uint64_t engine_due(const struct engine *e, uint32_t alarm)
{
	return e->s.due[alarm];
}

uint64_t engine_cycle(const struct engine *e)
{
	return clock_now(e) >> FRACTION;
}

void engine_irq(struct engine *e, uint32_t number, bool asserted)
{
	if (number < IRQ_COUNT)
		exceptions_set_line(e, EXC_IRQ0 + number, asserted);
}

void engine_nmi(struct engine *e)
{
	exceptions_pend(e, EXC_NMI);
}

uint32_t engine_load(struct engine *e, uint32_t address, uint32_t size)
{
	const uint8_t *const memory = host(e, address, size);
	uint32_t value = 0;

	if (memory == NULL)
		return windows_read(e, address, size);
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
		windows_write(e, address, size, value);
}

uint8_t *engine_memory(struct engine *e, uint32_t address, uint32_t size)
{
	return host(e, address, size);
}

int engine_poke(struct engine *e, uint32_t address, const uint8_t *data, uint32_t size)
{
	uint8_t *const memory = host(e, address, size);

	if (memory == NULL)
		return -1;
	memcpy(memory, data, size);
	if (row_of(address) != NOWHERE) {
		e->code_changed = true;
		clock_attend(e);
	}
	return 0;
}

void engine_core_clock(struct engine *e, uint64_t hz)
{
	clock_set_core(e, hz);
}

void engine_flash_busy(struct engine *e, uint64_t until)
{
	e->s.flash_busy = until > NEVER >> FRACTION ? NEVER >> FRACTION : until;
	e->s.flash_rested = until != 0u ? e->s.flash_busy : clock_now(e) >> FRACTION;
	clock_attend(e);
}

void engine_want_reset(struct engine *e)
{
	e->reset_wanted = true;
	clock_attend(e);
}
