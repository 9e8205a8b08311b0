/* The core's own registers (ARMv7-M DDI 0403E B3; Cortex-M7 TRM 3 to 5): SCB, floating point, caches, and where the
 * others are found. Reserved bits set, and registers that are not here, are errors of the image. */
#include <stddef.h>
#include <string.h>

#include "../base/machine.h"
#include "../code/code.h"
#include "system.h"

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
#define VECTKEY 0x05FAu
#define SYNC_ROOM 32u            /* bytes of code in which a DSB must follow */

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
	counters_reset(e);
}

/* ---- SCB (B3.2) ---- */

static uint32_t scb_icsr(const struct engine *e)
{
	const struct state *s = &e->s;
	uint32_t value = s->active[s->depth].exception | exceptions_first_pending(e) << 12;

	value |= s->depth <= 1u ? 1u << 11 : 0u;
	for (uint32_t i = EXC_IRQ0; i < EXCEPTION_COUNT; ++i)
		value |= (uint32_t)(get(&s->pending, i) && get(&s->enabled, i)) << 22;
	value |= (uint32_t)get(&s->pending, EXC_SYSTICK) << 26 | (uint32_t)get(&s->pending, EXC_PENDSV) << 28;
	return value | (uint32_t)get(&s->pending, EXC_NMI) << 31;
}

static void scb_icsr_write(struct engine *e, uint32_t value)
{
	if (value & 0x61000000u)
		fail(e, "SCB_ICSR = 0x%08X sets reserved bits", value);
	if (value & 1u << 31)
		exceptions_pend(e, EXC_NMI);
	if (value & 1u << 28)
		exceptions_pend(e, EXC_PENDSV);
	if (value & 1u << 27)
		put(&e->s.pending, EXC_PENDSV, false);
	if (value & 1u << 26)
		exceptions_pend(e, EXC_SYSTICK);
	if (value & 1u << 25)
		put(&e->s.pending, EXC_SYSTICK, false);
}

static void scb_aircr_write(struct engine *e, uint32_t value)
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
	clock_attend(e);
}

static uint32_t scb_shcsr(const struct engine *e)
{
	const struct state *s = &e->s;

	return s->shcsr | (uint32_t)get(&s->is_active, EXC_MEM) | (uint32_t)get(&s->is_active, EXC_BUS) << 1 |
	       (uint32_t)get(&s->is_active, EXC_USAGE) << 3 | (uint32_t)get(&s->is_active, EXC_SVC) << 7 |
	       (uint32_t)get(&s->is_active, EXC_PENDSV) << 10 | (uint32_t)get(&s->is_active, EXC_SYSTICK) << 11 |
	       (uint32_t)get(&s->pending, EXC_SVC) << 15;
}

static bool scb_is_cache_operation(uint32_t offset)
{
	return offset == 0xF50u || (offset >= 0xF58u && offset <= 0xF78u);
}

/* What a write does to a register that state holds. */
enum scs_writing { KEPT, CLEARED, SPECIAL }; /* it is kept; its ones clear bits; scs_write knows */

static const struct scs_register {
	uint16_t offset;
	uint16_t place; /* in struct state */
	enum scs_writing writing;
	uint32_t writable;
} scs_registers[] = {
	{0x008u, offsetof(struct state, actlr), KEPT, 0x1FFFFC05u},
	{0xD08u, offsetof(struct state, vtor), KEPT, 0xFFFFFF80u},
	{0xD10u, offsetof(struct state, scr), KEPT, 0x16u},
	{0xD14u, offsetof(struct state, ccr), SPECIAL, 0},
	{0xD28u, offsetof(struct state, cfsr), CLEARED, 0},
	{0xD2Cu, offsetof(struct state, hfsr), CLEARED, 0},
	{0xD30u, offsetof(struct state, dfsr), CLEARED, 0},
	{0xD34u, offsetof(struct state, mmfar), KEPT, UINT32_MAX},
	{0xD38u, offsetof(struct state, bfar), KEPT, UINT32_MAX},
	{0xD84u, offsetof(struct state, csselr), KEPT, 1u},
	{0xD88u, offsetof(struct state, cpacr), KEPT, 0x00F00000u},
	{0xD94u, offsetof(struct state, mpu_ctrl), KEPT, 7u},
	{0xD98u, offsetof(struct state, mpu_rnr), KEPT, 7u},
	{0xDFCu, offsetof(struct state, demcr), SPECIAL, 0},
	{0xF34u, offsetof(struct state, fpccr), SPECIAL, 0},
	{0xF38u, offsetof(struct state, fpcar), KEPT, UINT32_MAX},
	{0xF90u, offsetof(struct state, itcmcr), KEPT, 0x7Fu},
	{0xF94u, offsetof(struct state, dtcmcr), KEPT, 0x7Fu},
	{0xF98u, offsetof(struct state, ahbpcr), KEPT, 0xFu},
	{0xF9Cu, offsetof(struct state, cacr), KEPT, 7u},
};

static const struct scs_constant {
	uint16_t offset;
	uint32_t value;
} scs_constants[] = {
	{0x004u, (IRQ_COUNT - 1u) / 32u}, {0xD00u, CPUID}, {0xD3Cu, 0}, {0xD78u, CLIDR}, {0xD7Cu, CTR}, {0xD90u, MPU_TYPE},
	{0xF3Cu, 0}, {0xF40u, MVFR0}, {0xF44u, MVFR1}, {0xF48u, MVFR2},
};

/* NULL: state holds no register at `offset`. */
static const struct scs_register *scs_find(uint32_t offset)
{
	for (uint32_t i = 0; i < sizeof scs_registers / sizeof *scs_registers; ++i)
		if (scs_registers[i].offset == offset)
			return &scs_registers[i];
	return NULL;
}

static uint32_t *scs_word(struct engine *e, const struct scs_register *found)
{
	return (uint32_t *)((char *)&e->s + found->place);
}

/* Until a DSB has ended the store, an exception may still find its handler in the old table. */
static void scb_check_vectors_sync(struct engine *e)
{
	const uint8_t *const code = e->block == NULL ? NULL : host(e, e->at, SYNC_ROOM);

	if (code != NULL && !thumb_syncs_next(code, SYNC_ROOM))
		fail(e, "SCB_VTOR is changed without a DSB right after it: an exception may still use the old table");
}

static uint32_t scs_read(struct engine *e, uint32_t offset)
{
	if (offset >= 0x100u && offset < 0x340u)
		return nvic_read(e, offset);
	if (offset >= 0xD9Cu && offset <= 0xDB8u)
		return mpu_read(e, offset);
	if (offset >= 0x010u && offset < 0x020u)
		return systick_read(e, offset);
	const struct scs_register *const found = scs_find(offset);
	if (found != NULL)
		return *scs_word(e, found);
	for (uint32_t i = 0; i < sizeof scs_constants / sizeof *scs_constants; ++i)
		if (scs_constants[i].offset == offset)
			return scs_constants[i].value;
	switch (offset) {
	case 0xD04u:
		return scb_icsr(e);
	case 0xD0Cu:
		return 0xFA050000u | e->s.aircr;
	case 0xD24u:
		return scb_shcsr(e);
	case 0xD80u:
		return e->s.csselr & 1u ? CCSIDR_CODE : CCSIDR_DATA;
	default:
		fail(e, "read of 0x%08X, a register of the core that is not modelled", 0xE000E000u + offset);
		return 0;
	}
}

static void scs_keep(struct engine *e, const struct scs_register *found, uint32_t value)
{
	if (value & ~found->writable)
		fail(e, "0x%08X to the core's register 0x%08X sets reserved bits", value, 0xE000E000u + found->offset);
	if (found->offset == 0xD08u)
		scb_check_vectors_sync(e);
	*scs_word(e, found) = value & found->writable;
	clock_attend(e);
}

static void scs_write(struct engine *e, uint32_t offset, uint32_t value)
{
	const struct scs_register *const found = scs_find(offset);
	struct state *s = &e->s;

	if (offset >= 0x100u && offset < 0x340u) {
		nvic_write(e, offset, value);
		return;
	}
	if (offset >= 0xD9Cu && offset <= 0xDB8u) {
		mpu_write(e, offset, value);
		return;
	}
	if (offset >= 0x010u && offset < 0x01Cu) {
		systick_write(e, offset, value);
		return;
	}
	if (scb_is_cache_operation(offset))
		return; /* memory is always what the caches would hold */
	if (found != NULL && found->writing == KEPT) {
		scs_keep(e, found, value);
		return;
	}
	if (found != NULL && found->writing == CLEARED) {
		*scs_word(e, found) &= ~value;
		return;
	}
	switch (offset) {
	case 0xD04u:
		scb_icsr_write(e, value);
		return;
	case 0xD0Cu:
		scb_aircr_write(e, value);
		return;
	case 0xD14u:
		if (value & ~0x0007031Bu)
			fail(e, "SCB_CCR = 0x%08X sets reserved bits", value);
		s->ccr = (value & 0x0007011Bu) | CCR_RESET;
		return;
	case 0xD24u:
		if ((value ^ scb_shcsr(e)) & ~0x00070000u)
			fail(e, "SCB_SHCSR = 0x%08X changes active or pending exceptions, not modelled", value);
		s->shcsr = value & 0x00070000u;
		return;
	case 0xDFCu:
		demcr_write(e, value);
		return;
	case 0xF00u:
		if (value >= IRQ_COUNT)
			fail(e, "NVIC_STIR = %u, the chip has %u interrupts", value, IRQ_COUNT);
		else
			exceptions_pend(e, EXC_IRQ0 + value);
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

/* Registers whose bytes can be reached one by one: priorities and the fault status (B3.2.2, B3.4.2). */
static bool scs_has_bytes(uint32_t address)
{
	const uint32_t offset = address - 0xE000E000u;

	return (offset >= 0x400u && offset < 0x400u + IRQ_COUNT) || (offset >= 0xD18u && offset < 0xD2Cu);
}

uint32_t system_read(struct engine *e, uint32_t address, uint32_t size)
{
	const uint32_t offset = address - 0xE000E000u;

	if (size != 4u && !scs_has_bytes(address)) {
		fail(e, "read of %u bytes at 0x%08X, the register takes words only", size, address);
		return 0;
	}
	if (offset >= 0x400u && offset < 0x400u + IRQ_COUNT)
		return nvic_priorities(e, EXC_IRQ0 + offset - 0x400u, size);
	if (offset >= 0xD18u && offset < 0xD24u)
		return nvic_priorities(e, 4u + offset - 0xD18u, size);
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

	if (size != 4u && !scs_has_bytes(address))
		fail(e, "write of %u bytes at 0x%08X, the register takes words only", size, address);
	else if (offset >= 0x400u && offset < 0x400u + IRQ_COUNT)
		nvic_set_priorities(e, EXC_IRQ0 + offset - 0x400u, size, value);
	else if (offset >= 0xD18u && offset < 0xD24u)
		nvic_set_priorities(e, 4u + offset - 0xD18u, size, value);
	else if (offset < 0x1000u)
		scs_write(e, offset & ~3u, value << 8u * (offset & 3u));
	else if (address - 0xE0001000u < 0x1000u)
		dwt_write(e, address - 0xE0001000u, value);
	else
		fail(e, "write of 0x%08X to 0x%08X, where the core has nothing that is modelled", value, address);
}
