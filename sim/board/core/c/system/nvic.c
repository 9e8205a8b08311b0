/* Interrupts' enables and priorities (ARMv7-M DDI 0403E B3.4) and the regions of the MPU (B3.5). */
#include <stdio.h>

#include "../base/machine.h"
#include "system.h"

#define PRIORITY_BITS 0xF0u /* that the chip has */

/* ---- MPU: kept, and consulted when an access faults or the cache matters ---- */

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
bool mpu_caches(const struct engine *e, uint32_t address)
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

static bool mpu_meets(uint64_t first, uint64_t bytes, uint32_t base, uint32_t size)
{
	return first < (uint64_t)base + size && base < first + bytes;
}

/* The model does not enforce regions: one that closes memory or registers in use is an error. The null page is closed
 * without the MPU, and stores to flash and ITCM are rejected anyway. */
static void mpu_check_region(struct engine *e, uint32_t region)
{
	const uint32_t rasr = e->s.mpu_rasr[region], access = rasr >> 24 & 7u;
	const uint64_t first = e->s.mpu_rbar[region], bytes = UINT64_C(2) << (rasr >> 1 & 31u);
	const bool null_page = first + bytes <= 2u * NULL_PAGE_BYTES, no_code = rasr >> 28 & 1u;
	const bool on_code = mpu_meets(first, bytes, ITCM_BASE, ITCM_BYTES) || mpu_meets(first, bytes, ALIAS_BASE, FLASH_BYTES) ||
			     mpu_meets(first, bytes, FLASH_BASE, FLASH_BYTES);
	const bool on_data = mpu_meets(first, bytes, RAM_BASE, RAM_BYTES) || mpu_meets(first, bytes, APB_BASE, APB_BYTES) ||
			     mpu_meets(first, bytes, AHB2_BASE, AHB2_BYTES);

	if ((rasr & 1u) == 0u || null_page)
		return;
	if ((on_code && (access == 0u || no_code)) || (on_data && (access == 0u || access > 3u)))
		fail(e, "MPU region %u (MPU_RASR 0x%08X) closes 0x%08X to 0x%08X, where the image's memory or registers are",
		     region, rasr, (uint32_t)first, (uint32_t)(first + bytes - 1u));
}

void mpu_write(struct engine *e, uint32_t offset, uint32_t value)
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
	if (registers == e->s.mpu_rasr)
		mpu_check_region(e, region);
}

uint32_t mpu_read(struct engine *e, uint32_t offset)
{
	uint32_t region;
	const uint32_t *const registers = mpu_register(e, offset, &region);

	return registers[region] | (registers == e->s.mpu_rbar ? region : 0u);
}

/* ---- NVIC ---- */

static uint32_t nvic_bits(const struct flags *flags, uint32_t word)
{
	uint32_t bits = 0;

	for (uint32_t i = 0; i < 32u && word * 32u + i < IRQ_COUNT; ++i)
		bits |= (uint32_t)get(flags, EXC_IRQ0 + word * 32u + i) << i;
	return bits;
}

uint32_t nvic_read(struct engine *e, uint32_t offset)
{
	const uint32_t word = offset >> 2 & 7u;

	switch (offset & 0xF80u) {
	case 0x100u:
	case 0x180u:
		return nvic_bits(&e->s.enabled, word);
	case 0x200u:
	case 0x280u:
		return nvic_bits(&e->s.pending, word);
	default:
		return nvic_bits(&e->s.is_active, word);
	}
}

/* What must not wait must be able to interrupt everything else that is enabled: an equal priority is served in turn. */
static void nvic_check_urgency(struct engine *e)
{
	for (uint32_t urgent = EXC_IRQ0; urgent < EXCEPTION_COUNT; ++urgent) {
		if (!e->urgent[urgent] || !get(&e->s.enabled, urgent))
			continue;
		for (uint32_t i = EXC_SYSTICK; i < EXCEPTION_COUNT; ++i) {
			const bool on = i == EXC_SYSTICK ? systick_interrupts(e) : get(&e->s.enabled, i);

			if (i == urgent || !on || exceptions_preempts(e, urgent, i))
				continue;
			char name[32] = "SysTick";

			if (i != EXC_SYSTICK)
				snprintf(name, sizeof name, "interrupt %u", i - EXC_IRQ0);
			fail(e, "%s has priority %u and %s has %u: it waits until that handler is done, expected a more urgent one (a lower number)",
			     e->bound_name[urgent], e->s.priority[urgent] >> 4, name, e->s.priority[i] >> 4);
			return;
		}
	}
}

void nvic_write(struct engine *e, uint32_t offset, uint32_t value)
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
				e->s.pended_at[exception] = clock_now(e); /* it waits from now on */
			put(&e->s.enabled, exception, true);
			break;
		case 0x180u:
			put(&e->s.enabled, exception, false);
			break;
		case 0x200u:
			exceptions_pend(e, exception);
			break;
		case 0x280u: /* a line that is still high makes it pending again */
			put(&e->s.pending, exception, get(&e->s.line, exception) && !get(&e->s.is_active, exception));
			break;
		default:
			fail(e, "write of NVIC_IABR, which is read-only");
			return;
		}
	}
	if ((offset & 0xF80u) == 0x100u)
		nvic_check_urgency(e);
	clock_attend(e);
}

void nvic_set_priorities(struct engine *e, uint32_t exception, uint32_t size, uint32_t value)
{
	for (uint32_t i = 0; i < size; ++i, value >>= 8)
		if (exception + i < EXCEPTION_COUNT)
			e->s.priority[exception + i] = value & PRIORITY_BITS;
	nvic_check_urgency(e);
	clock_attend(e);
}

uint32_t nvic_priorities(const struct engine *e, uint32_t exception, uint32_t size)
{
	uint32_t value = 0;

	for (uint32_t i = 0; i < size && exception + i < EXCEPTION_COUNT; ++i)
		value |= (uint32_t)e->s.priority[exception + i] << 8 * i;
	return value;
}
