/* Counters of the core's cycles: SysTick (ARMv7-M DDI 0403E B3.3) and the DWT's cycle counter (C1.8). */
#include "../base/machine.h"
#include "system.h"

#define DWT_UNLOCK 0xC5ACCE55u
#define DWT_CYCCNTENA 1u
#define DWT_CTRL_RESET 0x40000000u /* four comparators, which are not modelled */
#define DEMCR_TRCENA (1u << 24)
#define DEMCR_OTHERS 0x000107F1u   /* vector catch and monitor: a debugger's, without effect here */
#define SYST_ENABLE 1u
#define SYST_TICKINT 2u
#define SYST_CORE 4u
#define SYST_COUNTFLAG (1u << 16)
#define SYST_CALIB 0x40000000u     /* no exact 10 ms known */

void counters_reset(struct engine *e)
{
	struct state *s = &e->s;

	s->demcr = 0;
	s->dwt_ctrl = DWT_CTRL_RESET;
	s->dwt_held = s->dwt_zero = 0;
	s->dwt_unlocked = false;
	s->syst_csr = s->syst_rvr = s->syst_held = 0;
	s->syst_zero = NEVER;
}

/* ---- SysTick: CLKSOURCE 0 is the core clock by 8 (RM0431 5.2) ---- */

static uint64_t systick_step(const struct state *s)
{
	return s->syst_csr & SYST_CORE ? 1u : 8u;
}

static uint64_t counters_core_now(const struct engine *e)
{
	return clock_core_cycles(e, clock_now(e));
}

void systick_fire(struct engine *e)
{
	struct state *s = &e->s;

	s->syst_csr |= SYST_COUNTFLAG;
	if (s->syst_csr & SYST_TICKINT)
		exceptions_pend(e, EXC_SYSTICK);
	s->syst_zero = s->syst_rvr ? s->syst_zero + (s->syst_rvr + UINT64_C(1)) * systick_step(s) : NEVER;
	s->syst_held = 0;
}

static uint32_t systick_value(const struct engine *e)
{
	const struct state *s = &e->s;

	if (s->syst_zero == NEVER)
		return s->syst_held;
	const uint64_t left = (s->syst_zero - counters_core_now(e) + systick_step(s) - 1u) / systick_step(s);
	return left > s->syst_rvr ? 0u : (uint32_t)left;
}

/* The counter stands at `value` and goes on from there, when it may. */
static void systick_go(struct engine *e, uint32_t value)
{
	struct state *s = &e->s;
	const uint64_t left = value ? value : s->syst_rvr + UINT64_C(1);

	s->syst_held = value;
	s->syst_zero = s->syst_csr & SYST_ENABLE && s->syst_rvr + value != 0u ? counters_core_now(e) + left * systick_step(s) : NEVER;
	clock_alarms_changed(e);
}

bool systick_interrupts(const struct engine *e)
{
	return (e->s.syst_csr & (SYST_ENABLE | SYST_TICKINT)) == (SYST_ENABLE | SYST_TICKINT);
}

uint32_t systick_read(struct engine *e, uint32_t offset)
{
	const uint32_t csr = e->s.syst_csr;

	switch (offset) {
	case 0x010u:
		e->s.syst_csr &= ~SYST_COUNTFLAG;
		return csr;
	case 0x014u:
		return e->s.syst_rvr;
	case 0x018u:
		return systick_value(e);
	default:
		return SYST_CALIB;
	}
}

void systick_write(struct engine *e, uint32_t offset, uint32_t value)
{
	struct state *s = &e->s;
	const uint32_t held = systick_value(e);

	switch (offset) {
	case 0x010u:
		if (value & ~0x10007u)
			fail(e, "SYST_CSR = 0x%08X sets reserved bits", value);
		s->syst_csr = (s->syst_csr & SYST_COUNTFLAG) | (value & 7u);
		systick_go(e, held);
		break;
	case 0x014u:
		if (value >> 24)
			fail(e, "SYST_RVR = 0x%08X, the counter has 24 bits", value);
		s->syst_rvr = value & 0xFFFFFFu;
		break;
	default:
		s->syst_csr &= ~SYST_COUNTFLAG;
		systick_go(e, 0);
		break;
	}
}

/* ---- DWT: the counter follows the core's cycles while DEMCR and DWT_CTRL let it ---- */

static bool dwt_counts(const struct state *s)
{
	return s->demcr & DEMCR_TRCENA && s->dwt_ctrl & DWT_CYCCNTENA;
}

static uint32_t dwt_value(const struct engine *e)
{
	return dwt_counts(&e->s) ? (uint32_t)counters_core_now(e) - e->s.dwt_zero : e->s.dwt_held;
}

static void dwt_change(struct engine *e, uint32_t demcr, uint32_t ctrl, uint32_t value)
{
	e->s.demcr = demcr;
	e->s.dwt_ctrl = ctrl;
	e->s.dwt_held = value;
	e->s.dwt_zero = (uint32_t)counters_core_now(e) - value;
}

void demcr_write(struct engine *e, uint32_t value)
{
	if (value & ~(DEMCR_TRCENA | DEMCR_OTHERS))
		fail(e, "DCB_DEMCR = 0x%08X sets reserved bits", value);
	dwt_change(e, value, e->s.dwt_ctrl, dwt_value(e));
}

uint32_t dwt_read(struct engine *e, uint32_t offset)
{
	switch (offset) {
	case 0x000u:
		return e->s.dwt_ctrl;
	case 0x004u:
		return dwt_value(e);
	case 0xFB4u:
		return e->s.dwt_unlocked ? 1u : 3u;
	default:
		fail(e, "read of 0x%08X, a register of the DWT that is not modelled", 0xE0001000u + offset);
		return 0;
	}
}

/* Locked, the unit ignores what is written to it, as on the chip. */
void dwt_write(struct engine *e, uint32_t offset, uint32_t value)
{
	struct state *s = &e->s;

	if (offset == 0xFB0u)
		s->dwt_unlocked = value == DWT_UNLOCK;
	else if (offset != 0x000u && offset != 0x004u)
		fail(e, "write of 0x%08X, a register of the DWT that is not modelled", 0xE0001000u + offset);
	else if (s->dwt_unlocked && s->demcr & DEMCR_TRCENA) {
		if (offset == 0x004u)
			dwt_change(e, s->demcr, s->dwt_ctrl, value);
		else if ((value ^ s->dwt_ctrl) & ~DWT_CYCCNTENA)
			fail(e, "DWT_CTRL = 0x%08X, only CYCCNTENA is modelled", value);
		else
			dwt_change(e, s->demcr, value, dwt_value(e));
	}
}
