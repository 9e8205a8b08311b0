#include "hal/stm32f7/core/core.h"

#include "hal/stm32f7/core/registers.h"

/* Attributes of a region (MPU_RASR; ARMv7-M B3.5.9). */
#define NO_ACCESS 0u
enum { FULL_ACCESS = 3, NORMAL_UNCACHED = 1 }; /* AP; TEX with C and B 0 */
#define UNCACHED (FIELD(MPU_RASR_AP, FULL_ACCESS) | FIELD(MPU_RASR_TEX, NORMAL_UNCACHED))

/* MPU regions that differ from the chip's default memory map. */
static const struct region {
	uint32_t address;
	uint32_t log2_size;
	uint32_t attributes;
} regions[] = {
	{ 0x00000000u, 9, NO_ACCESS }, /* null pointers: the first 512 bytes of ITCM, which the linker leaves empty */
	/* No external memory on this board; a speculative read there may stall the bus for good. */
	{ 0x60000000u, 29, NO_ACCESS },
	{ 0x80000000u, 29, NO_ACCESS },
	{ 0x2003C000u, 14, UNCACHED }, /* SRAM2: DMA buffers */
};

static void core_protect_memory(void)
{
	MPU_CTRL = 0;
	for (uint32_t i = 0; i < sizeof regions / sizeof regions[0]; ++i) {
		MPU_RNR = i;
		MPU_RBAR = regions[i].address;
		MPU_RASR = regions[i].attributes | MPU_RASR_XN | FIELD(MPU_RASR_SIZE, regions[i].log2_size - 1u) |
			   MPU_RASR_ENABLE;
	}
	MPU_CTRL = MPU_CTRL_PRIVDEFENA | MPU_CTRL_ENABLE;
	barrier_instructions();
}

static void core_enable_instruction_cache(void)
{
	barrier_instructions();
	SCB_ICIALLU = 0;
	barrier_instructions();
	SCB_CCR |= SCB_CCR_IC;
	barrier_instructions();
}

/* Writes `operation` for every line of the data cache. DCISW and its like: way from bit 31 down, set from bit 5 up
 * (32-byte lines; Cortex-M7 TRM 4.4, ARMv7-M B3.2.26). */
static void core_for_each_line(volatile uint32_t *operation)
{
	SCB_CSSELR = 0; /* level 1, data */
	barrier();
	const uint32_t size = SCB_CCSIDR;
	const uint32_t last_way = VALUE(SCB_CCSIDR_ASSOCIATIVITY, size);
	const uint32_t last_set = VALUE(SCB_CCSIDR_NUMSETS, size);
	const uint32_t way_shift = last_way == 0u ? 0u : (uint32_t)__builtin_clz(last_way);

	for (uint32_t set = 0; set <= last_set; ++set)
		for (uint32_t way = 0; way <= last_way; ++way)
			*operation = way << way_shift | set << 5;
	barrier();
}

/* The cache's contents are undefined after power-up: every line is invalidated before it may answer. */
static void core_enable_data_cache(void)
{
	core_for_each_line(&SCB_DCISW);
	SCB_CCR |= SCB_CCR_DC;
	barrier_instructions();
}

void core_clean_caches(void)
{
	core_for_each_line(&SCB_DCCISW);
	SCB_ICIALLU = 0;
	barrier_instructions();
}

void core_start(void)
{
	SCB_SHCSR |= SCB_SHCSR_MEMFAULTENA | SCB_SHCSR_BUSFAULTENA | SCB_SHCSR_USGFAULTENA;
	SCB_CCR |= SCB_CCR_UNALIGN_TRP | SCB_CCR_DIV_0_TRP;
	core_protect_memory();
	core_enable_instruction_cache();
	core_enable_data_cache();
}

void interrupt_enable(uint32_t irq, enum priority priority)
{
	const uint32_t field = BITS(8u * (irq % 4u), 8);

	/* The chip implements the upper 4 bits of each priority byte. */
	NVIC_IPR(irq / 4u) = (NVIC_IPR(irq / 4u) & ~field) | FIELD(field, (uint32_t)priority << 4);
	NVIC_ISER(irq / 32u) = 1u << (irq % 32u);
	barrier_instructions();
}
