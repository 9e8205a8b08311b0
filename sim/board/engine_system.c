/* The core's own registers: NVIC, SCB, SysTick, MPU, floating point, caches, DWT (ARMv7-M DDI 0403E B3, C1;
 * Cortex-M7 TRM 3 to 5). Reserved bits set, and registers that are not here, are errors of the image. */
#include <string.h>

#include "engine.h"

#define CPUID 0x411FC270u        /* Cortex-M7 r1p0 */
#define CCR_RESET 0x00040200u    /* BP and STKALIGN read as one */
#define CCSIDR_DATA 0xF007E019u  /* 8 KB: 64 sets of 4 ways, 32 bytes a line (TRM 4.4) */
#define CCSIDR_CODE 0xF00FE009u  /* 8 KB: 128 sets of 2 ways */
#define CLIDR 0x09000003u
#define CTR 0x8303C003u
#define MVFR0 0x10110021u        /* single precision */
#define MVFR1 0x11000011u
#define MVFR2 0x00000040u
#define FPCCR_RESET 0xC0000000u
#define MPU_TYPE (MPU_REGIONS << 8)
#define DWT_UNLOCK 0xC5ACCE55u
#define DWT_CYCCNTENA 1u
#define DWT_CTRL_RESET 0x40000000u /* four comparators, which are not modelled */
#define DEMCR_TRCENA (1u << 24)
#define SYST_ENABLE 1u
#define SYST_TICKINT 2u
#define SYST_CORE 4u
#define SYST_COUNTFLAG (1u << 16)
#define VECTKEY 0x05FAu
#define PRIORITY_BITS 0xF0u

void system_reset_registers(struct engine *e)
{
	struct state *s = &e->s;

	s->vtor = ALIAS_BASE;
	s->aircr = s->scr = s->cpacr = s->cfsr = s->hfsr = s->dfsr = s->csselr = s->shcsr = 0;
	s->mmfar = s->bfar = s->fpcar = s->actlr = s->ahbpcr = s->cacr = 0;
	s->itcmcr = s->dtcmcr = 1u;
	s->ccr = CCR_RESET;
	s->fpccr = FPCCR_RESET;
	s->mpu_ctrl = s->mpu_rnr = 0;
	memset(s->mpu_rbar, 0, sizeof s->mpu_rbar);
	memset(s->mpu_rasr, 0, sizeof s->mpu_rasr);
	s->demcr = 0;
	s->dwt_ctrl = DWT_CTRL_RESET;
	s->dwt_held = s->dwt_zero = 0;
	s->dwt_unlocked = false;
	s->syst_csr = s->syst_rvr = s->syst_held = 0;
	s->syst_zero = NEVER;
}

/* ---- SysTick (B3.3): counts core cycles; CLKSOURCE 0 is the core clock by 8 (RM0431 5.2) ---- */

static uint64_t step(const struct state *s)
{
	return s->syst_csr & SYST_CORE ? 1u : 8u;
}

static uint64_t core_now(const struct engine *e)
{
	return core_cycles_at(e, now(e));
}

uint64_t systick_due(const struct engine *e)
{
	return e->s.syst_zero == NEVER ? NEVER : time_of_core_cycles(e, e->s.syst_zero);
}

void systick_fire(struct engine *e)
{
	struct state *s = &e->s;

	s->syst_csr |= SYST_COUNTFLAG;
	if (s->syst_csr & SYST_TICKINT)
		pend(e, EXC_SYSTICK);
	s->syst_zero = s->syst_rvr ? s->syst_zero + (s->syst_rvr + UINT64_C(1)) * step(s) : NEVER;
	s->syst_held = 0;
}

static uint32_t systick_value(const struct engine *e)
{
	const struct state *s = &e->s;

	if (s->syst_zero == NEVER)
		return s->syst_held;
	const uint64_t left = (s->syst_zero - core_now(e) + step(s) - 1u) / step(s);
	return left > s->syst_rvr ? 0u : (uint32_t)left;
}

/* The counter stands at `value` and goes on from there, when it may. */
static void systick_go(struct engine *e, uint32_t value)
{
	struct state *s = &e->s;
	const uint64_t left = value ? value : s->syst_rvr + UINT64_C(1);

	s->syst_held = value;
	s->syst_zero = s->syst_csr & SYST_ENABLE && s->syst_rvr + value != 0u ? core_now(e) + left * step(s) : NEVER;
	alarms_changed(e);
}

/* ---- DWT (C1.8): the counter follows the core's cycles while DEMCR and DWT_CTRL let it ---- */

static bool dwt_counts(const struct state *s)
{
	return s->demcr & DEMCR_TRCENA && s->dwt_ctrl & DWT_CYCCNTENA;
}

static uint32_t dwt_value(const struct engine *e)
{
	return dwt_counts(&e->s) ? (uint32_t)core_now(e) - e->s.dwt_zero : e->s.dwt_held;
}

static void dwt_change(struct engine *e, uint32_t demcr, uint32_t ctrl, uint32_t value)
{
	e->s.demcr = demcr;
	e->s.dwt_ctrl = ctrl;
	e->s.dwt_held = value;
	e->s.dwt_zero = (uint32_t)core_now(e) - value;
}

/* ---- MPU (B3.5): kept and looked at when an access finds nothing ---- */

/* RASR of the region that rules `address`: the highest one that covers it (B3.5.1); 0: none. */
static uint32_t mpu_attributes(const struct engine *e, uint32_t address)
{
	if ((e->s.mpu_ctrl & 1u) == 0u)
		return 0;
	for (uint32_t i = MPU_REGIONS; i-- > 0u;) {
		const uint32_t rasr = e->s.mpu_rasr[i], bits = (rasr >> 1 & 31u) + 1u;
		const uint64_t offset = (uint64_t)address - (e->s.mpu_rbar[i] & ~31u);
		const bool part_off = bits >= 8u && bits < 33u && rasr >> 8 >> (offset >> (bits - 3u) & 7u) & 1u;

		if (rasr & 1u && bits >= 5u && offset < UINT64_C(1) << bits && !part_off)
			return rasr;
	}
	return 0;
}

bool mpu_closes(const struct engine *e, uint32_t address)
{
	const uint32_t rasr = mpu_attributes(e, address);

	return rasr != 0u && (rasr >> 24 & 7u) == 0u;
}

/* SRAM1, SRAM2 and flash are cached by default (B3.1); a region makes them otherwise when it is not normal memory
 * with a cached inner policy: TEX, C, B of table B3-13. Shared memory is not cached by this core (TRM 5.2). */
bool data_is_cached(const struct engine *e, uint32_t address)
{
	const uint32_t rasr = mpu_attributes(e, address);
	const uint32_t tex = rasr >> 19 & 7u, shared = rasr >> 18 & 1u, c = rasr >> 17 & 1u, b = rasr >> 16 & 1u;
	const bool memory = (address >= RAM_BASE + DTCM_BYTES && address - RAM_BASE < RAM_BYTES) ||
			    address - FLASH_BASE < FLASH_BYTES;

	if ((e->s.ccr >> 16 & 1u) == 0u || !memory)
		return false;
	return rasr == 0u || (!shared && (tex & 4u ? c | b : c & (tex == 0u || b)));
}

static uint32_t *mpu_register(struct engine *e, uint32_t offset, uint32_t *region)
{
	*region = e->s.mpu_rnr;
	if ((offset - 0xD9Cu) % 8u == 0u)
		return e->s.mpu_rbar;
	return e->s.mpu_rasr;
}

static void mpu_write(struct engine *e, uint32_t offset, uint32_t value)
{
	uint32_t region;
	uint32_t *const registers = mpu_register(e, offset, &region);

	if (registers == e->s.mpu_rbar && value & 0x10u)
		region = e->s.mpu_rnr = value & 15u;
	if (region >= MPU_REGIONS) {
		fail(e, "MPU region %u, the core has %u", region, MPU_REGIONS);
		return;
	}
	if (registers == e->s.mpu_rasr && value & 0xE8C000C0u)
		fail(e, "MPU_RASR = 0x%08X sets reserved bits", value);
	registers[region] = registers == e->s.mpu_rbar ? value & ~31u : value;
}

/* ---- NVIC (B3.4) ---- */

static uint32_t bits_of(const struct flags *flags, uint32_t word)
{
	uint32_t bits = 0;

	for (uint32_t i = 0; i < 32u && word * 32u + i < IRQ_COUNT; ++i)
		bits |= (uint32_t)get(flags, EXC_IRQ0 + word * 32u + i) << i;
	return bits;
}

static uint32_t nvic_read(struct engine *e, uint32_t offset)
{
	const uint32_t word = offset >> 2 & 7u;

	switch (offset & 0xF80u) {
	case 0x100u:
	case 0x180u:
		return bits_of(&e->s.enabled, word);
	case 0x200u:
	case 0x280u:
		return bits_of(&e->s.pending, word);
	default:
		return bits_of(&e->s.is_active, word);
	}
}

static void nvic_write(struct engine *e, uint32_t offset, uint32_t value)
{
	const uint32_t word = offset >> 2 & 7u;

	for (uint32_t i = 0; i < 32u; ++i) {
		const uint32_t exception = EXC_IRQ0 + word * 32u + i;

		if ((value >> i & 1u) == 0u)
			continue;
		if (exception >= EXCEPTION_COUNT) {
			fail(e, "interrupt %u in the NVIC, the chip has %u", exception - EXC_IRQ0, IRQ_COUNT);
			return;
		}
		switch (offset & 0xF80u) {
		case 0x100u:
			if (!get(&e->s.enabled, exception))
				e->s.pended_at[exception] = now(e); /* it waits from now on */
			put(&e->s.enabled, exception, true);
			break;
		case 0x180u:
			put(&e->s.enabled, exception, false);
			break;
		case 0x200u:
			pend(e, exception);
			break;
		case 0x280u: /* a line that is still high makes it pending again */
			put(&e->s.pending, exception, get(&e->s.line, exception) && !get(&e->s.is_active, exception));
			break;
		default:
			fail(e, "write of NVIC_IABR, which is read-only");
			return;
		}
	}
	look_again(e);
}

static void set_priorities(struct engine *e, uint32_t exception, uint32_t size, uint32_t value)
{
	for (uint32_t i = 0; i < size; ++i, value >>= 8)
		if (exception + i < EXCEPTION_COUNT)
			e->s.priority[exception + i] = value & PRIORITY_BITS;
	look_again(e);
}

static uint32_t priorities(const struct engine *e, uint32_t exception, uint32_t size)
{
	uint32_t value = 0;

	for (uint32_t i = 0; i < size && exception + i < EXCEPTION_COUNT; ++i)
		value |= (uint32_t)e->s.priority[exception + i] << 8 * i;
	return value;
}

/* ---- SCB (B3.2) ---- */

static uint32_t icsr(const struct engine *e)
{
	const struct state *s = &e->s;
	uint32_t value = s->active[s->depth].exception | first_pending(e) << 12;

	value |= s->depth <= 1u ? 1u << 11 : 0u;
	for (uint32_t i = EXC_IRQ0; i < EXCEPTION_COUNT; ++i)
		value |= (uint32_t)(get(&s->pending, i) && get(&s->enabled, i)) << 22;
	value |= (uint32_t)get(&s->pending, EXC_SYSTICK) << 26 | (uint32_t)get(&s->pending, EXC_PENDSV) << 28;
	return value | (uint32_t)get(&s->pending, EXC_NMI) << 31;
}

static void icsr_write(struct engine *e, uint32_t value)
{
	if (value & 0x61000000u)
		fail(e, "SCB_ICSR = 0x%08X sets reserved bits", value);
	if (value & 1u << 31)
		pend(e, EXC_NMI);
	if (value & 1u << 28)
		pend(e, EXC_PENDSV);
	if (value & 1u << 27)
		put(&e->s.pending, EXC_PENDSV, false);
	if (value & 1u << 26)
		pend(e, EXC_SYSTICK);
	if (value & 1u << 25)
		put(&e->s.pending, EXC_SYSTICK, false);
}

static void aircr_write(struct engine *e, uint32_t value)
{
	if (value >> 16 != VECTKEY) {
		fail(e, "SCB_AIRCR = 0x%08X without its key 0x05FA", value);
		return;
	}
	if (value & 0x78FBu) {
		fail(e, "SCB_AIRCR = 0x%08X sets reserved bits or VECTRESET, VECTCLRACTIVE", value);
		return;
	}
	e->s.aircr = value & 0x700u;
	if (value & 4u)
		e->reset_wanted = true;
	look_again(e);
}

static uint32_t shcsr(const struct engine *e)
{
	const struct state *s = &e->s;

	return s->shcsr | (uint32_t)get(&s->is_active, EXC_MEM) | (uint32_t)get(&s->is_active, EXC_BUS) << 1 |
	       (uint32_t)get(&s->is_active, EXC_USAGE) << 3 | (uint32_t)get(&s->is_active, EXC_SVC) << 7 |
	       (uint32_t)get(&s->is_active, EXC_PENDSV) << 10 | (uint32_t)get(&s->is_active, EXC_SYSTICK) << 11 |
	       (uint32_t)get(&s->pending, EXC_SVC) << 15;
}

static uint32_t ccsidr(const struct engine *e)
{
	return e->s.csselr & 1u ? CCSIDR_CODE : CCSIDR_DATA;
}

static bool is_cache_operation(uint32_t offset)
{
	return offset == 0xF50u || (offset >= 0xF58u && offset <= 0xF78u);
}

static uint32_t *stored(struct engine *e, uint32_t offset, uint32_t *allowed)
{
	struct state *s = &e->s;

	*allowed = UINT32_MAX;
	switch (offset) {
	case 0x008u:
		*allowed = 0x1FFFFC05u;
		return &s->actlr;
	case 0xD08u:
		*allowed = 0xFFFFFF80u;
		return &s->vtor;
	case 0xD10u:
		*allowed = 0x16u;
		return &s->scr;
	case 0xD34u:
		return &s->mmfar;
	case 0xD38u:
		return &s->bfar;
	case 0xD84u:
		*allowed = 1u;
		return &s->csselr;
	case 0xD88u:
		*allowed = 0x00F00000u;
		return &s->cpacr;
	case 0xD94u:
		*allowed = 7u;
		return &s->mpu_ctrl;
	case 0xD98u:
		*allowed = 7u;
		return &s->mpu_rnr;
	case 0xF38u:
		return &s->fpcar;
	case 0xF90u:
		*allowed = 0x7Fu;
		return &s->itcmcr;
	case 0xF94u:
		*allowed = 0x7Fu;
		return &s->dtcmcr;
	case 0xF98u:
		*allowed = 0xFu;
		return &s->ahbpcr;
	case 0xF9Cu:
		*allowed = 7u;
		return &s->cacr;
	default:
		return NULL;
	}
}

static uint32_t scs_read(struct engine *e, uint32_t offset)
{
	struct state *s = &e->s;
	uint32_t region, allowed, value;

	if (offset >= 0x100u && offset < 0x340u)
		return nvic_read(e, offset);
	if (offset >= 0xD9Cu && offset <= 0xDB8u) {
		const uint32_t *const registers = mpu_register(e, offset, &region);
		return registers[region] | (registers == s->mpu_rbar ? region : 0u);
	}
	const uint32_t *const plain = stored(e, offset, &allowed);
	if (plain != NULL)
		return *plain;
	switch (offset) {
	case 0x004u:
		return (IRQ_COUNT - 1u) / 32u;
	case 0x010u:
		value = s->syst_csr;
		s->syst_csr &= ~SYST_COUNTFLAG;
		return value;
	case 0x014u:
		return s->syst_rvr;
	case 0x018u:
		return systick_value(e);
	case 0x01Cu:
		return 0x40000000u; /* no exact 10 ms known */
	case 0xD00u:
		return CPUID;
	case 0xD04u:
		return icsr(e);
	case 0xD0Cu:
		return 0xFA050000u | s->aircr;
	case 0xD14u:
		return s->ccr;
	case 0xD24u:
		return shcsr(e);
	case 0xD28u:
		return s->cfsr;
	case 0xD2Cu:
		return s->hfsr;
	case 0xD30u:
		return s->dfsr;
	case 0xD3Cu:
		return 0;
	case 0xD78u:
		return CLIDR;
	case 0xD7Cu:
		return CTR;
	case 0xD80u:
		return ccsidr(e);
	case 0xD90u:
		return MPU_TYPE;
	case 0xDFCu:
		return s->demcr;
	case 0xF34u:
		return s->fpccr;
	case 0xF3Cu:
		return 0;
	case 0xF40u:
		return MVFR0;
	case 0xF44u:
		return MVFR1;
	case 0xF48u:
		return MVFR2;
	default:
		fail(e, "read of 0x%08X, a register of the core that is not modelled", 0xE000E000u + offset);
		return 0;
	}
}

static void scs_write(struct engine *e, uint32_t offset, uint32_t value)
{
	struct state *s = &e->s;
	uint32_t allowed, *plain;

	if (offset >= 0x100u && offset < 0x340u) {
		nvic_write(e, offset, value);
		return;
	}
	if (offset >= 0xD9Cu && offset <= 0xDB8u) {
		mpu_write(e, offset, value);
		return;
	}
	if (is_cache_operation(offset))
		return; /* memory is always what the caches would hold */
	plain = stored(e, offset, &allowed);
	if (plain != NULL) {
		if (value & ~allowed)
			fail(e, "0x%08X to the core's register 0x%08X sets reserved bits", value, 0xE000E000u + offset);
		*plain = value & allowed;
		look_again(e);
		return;
	}
	switch (offset) {
	case 0x010u: {
		const uint32_t held = systick_value(e);

		if (value & ~0x10007u)
			fail(e, "SYST_CSR = 0x%08X sets reserved bits", value);
		s->syst_csr = (s->syst_csr & SYST_COUNTFLAG) | (value & 7u);
		systick_go(e, held);
		return;
	}
	case 0x014u:
		if (value >> 24)
			fail(e, "SYST_RVR = 0x%08X, the counter has 24 bits", value);
		s->syst_rvr = value & 0xFFFFFFu;
		return;
	case 0x018u:
		s->syst_csr &= ~SYST_COUNTFLAG;
		systick_go(e, 0);
		return;
	case 0xD04u:
		icsr_write(e, value);
		return;
	case 0xD0Cu:
		aircr_write(e, value);
		return;
	case 0xD14u:
		if (value & ~0x0007031Bu)
			fail(e, "SCB_CCR = 0x%08X sets reserved bits", value);
		s->ccr = (value & 0x0007011Bu) | CCR_RESET;
		return;
	case 0xD24u:
		if ((value ^ shcsr(e)) & ~0x00070000u)
			fail(e, "SCB_SHCSR = 0x%08X changes active or pending exceptions, not modelled", value);
		s->shcsr = value & 0x00070000u;
		return;
	case 0xD28u:
		s->cfsr &= ~value;
		return;
	case 0xD2Cu:
		s->hfsr &= ~value;
		return;
	case 0xD30u:
		s->dfsr &= ~value;
		return;
	case 0xDFCu:
		if (value & ~(DEMCR_TRCENA | 0x000107F1u))
			fail(e, "DCB_DEMCR = 0x%08X sets reserved bits", value);
		dwt_change(e, value, s->dwt_ctrl, dwt_value(e));
		return;
	case 0xF00u:
		if (value >= IRQ_COUNT)
			fail(e, "NVIC_STIR = %u, the chip has %u interrupts", value, IRQ_COUNT);
		else
			pend(e, EXC_IRQ0 + value);
		return;
	case 0xF34u:
		if ((value & 0x80000000u) == 0u)
			fail(e, "FPCCR = 0x%08X: no automatic state preservation, not modelled", value);
		s->fpccr = value & 0xC0000000u;
		return;
	case 0xF3Cu:
		if (value != 0u)
			fail(e, "FPDSCR = 0x%08X, only 0 is modelled", value);
		return;
	default:
		fail(e, "write of 0x%08X to 0x%08X, a register of the core that is not modelled or not writable", value,
		     0xE000E000u + offset);
	}
}

static uint32_t dwt_read(struct engine *e, uint32_t offset)
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
static void dwt_write(struct engine *e, uint32_t offset, uint32_t value)
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

/* Registers whose bytes can be reached one by one: priorities and the fault status (B3.2.2, B3.4.2). */
static bool has_bytes(uint32_t address)
{
	const uint32_t offset = address - 0xE000E000u;

	return (offset >= 0x400u && offset < 0x400u + IRQ_COUNT) || (offset >= 0xD18u && offset < 0xD2Cu);
}

uint32_t system_read(struct engine *e, uint32_t address, uint32_t size)
{
	const uint32_t offset = address - 0xE000E000u;

	if (size != 4u && !has_bytes(address)) {
		fail(e, "read of %u bytes at 0x%08X, the register takes words only", size, address);
		return 0;
	}
	if (offset >= 0x400u && offset < 0x400u + IRQ_COUNT)
		return priorities(e, EXC_IRQ0 + offset - 0x400u, size);
	if (offset >= 0xD18u && offset < 0xD24u)
		return priorities(e, 4u + offset - 0xD18u, size);
	if (offset < 0x1000u) {
		const uint32_t word = scs_read(e, offset & ~3u) >> 8u * (offset & 3u);

		return size == 4u ? word : word & ((1u << 8u * size) - 1u);
	}
	if (address - 0xE0001000u < 0x1000u)
		return dwt_read(e, address - 0xE0001000u);
	fail(e, "read of 0x%08X, where the core has nothing that is modelled", address);
	return 0;
}

void system_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value)
{
	const uint32_t offset = address - 0xE000E000u;

	if (size != 4u && !has_bytes(address))
		fail(e, "write of %u bytes at 0x%08X, the register takes words only", size, address);
	else if (offset >= 0x400u && offset < 0x400u + IRQ_COUNT)
		set_priorities(e, EXC_IRQ0 + offset - 0x400u, size, value);
	else if (offset >= 0xD18u && offset < 0xD24u)
		set_priorities(e, 4u + offset - 0xD18u, size, value);
	else if (offset < 0x1000u)
		scs_write(e, offset & ~3u, value << 8u * (offset & 3u));
	else if (address - 0xE0001000u < 0x1000u)
		dwt_write(e, address - 0xE0001000u, value);
	else
		fail(e, "write of 0x%08X to 0x%08X, where the core has nothing that is modelled", value, address);
}
