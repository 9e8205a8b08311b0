/* From the bank's reset vector to main: FPU, code and data in place, then the program. */
#include <stdint.h>

#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/stop.h"

/* Linker script: where each part lies in flash (load) and where it runs; all word-aligned. */
extern const uint32_t bank_start[], itcm_load[], data_load[];
extern uint32_t itcm_start[], itcm_end[], data_start[], data_end[], bss_start[], bss_end[];
extern uint32_t sram_bss_start[], sram_bss_end[], uncached_bss_start[], uncached_bss_end[];
extern uint32_t fast_vectors[], fast_vectors_end[];

int main(int argc, char **argv);

static void startup_copy(uint32_t *to, const uint32_t *end, const uint32_t *from)
{
	while (to != end)
		*to++ = *from++;
}

/* Eight words at a time: the processor still runs at 16 MHz, and the motors' controllers wait for their stop frames. */
static void startup_clear(uint32_t *from, const uint32_t *end)
{
	for (; end - from >= 8; from += 8) {
		from[0] = from[1] = from[2] = from[3] = 0;
		from[4] = from[5] = from[6] = from[7] = 0;
	}
	while (from != end)
		*from++ = 0;
}

/* Runs on the stack that the boot part loaded. No floating-point instruction may come before CPACR is set;
 * built with general registers only (target.mk). */
void reset_handler(void)
{
	interrupts_disable(); /* the boot part has pointed VTOR to the bank's own copy of the table */
	SCB_CPACR |= SCB_CPACR_CP10 | SCB_CPACR_CP11; /* full access (ARMv7-M B3.2.20) */
	barrier_instructions();

	startup_copy(fast_vectors, fast_vectors_end, bank_start); /* the vectors head the bank */
	startup_copy(itcm_start, itcm_end, itcm_load);
	startup_copy(data_start, data_end, data_load);
	startup_clear(bss_start, bss_end);
	startup_clear(sram_bss_start, sram_bss_end);
	startup_clear(uncached_bss_start, uncached_bss_end);
	barrier_instructions();
	SCB_VTOR = (uint32_t)fast_vectors;
	barrier_instructions();

	interrupts_enable();
	(void)main(0, 0);
	stop(LED_REFUSED); /* hal_run never returns and hal_init always asks for it */
}
