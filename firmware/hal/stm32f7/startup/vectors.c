/* The vector table of the image (ARMv7-M B1.5.2, RM0431 chapter NVIC). It heads the bank, where the boot part finds it;
 * start-up copies it to ITCM. */
#include <stdint.h>

#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/registers.h"

extern uint32_t stack_top[]; /* linker script */

#define SYSTEM_HANDLERS 15
enum { TICK = 14 }; /* exception 15 */

struct vector_table {
	uint32_t *stack;
	void (*system[SYSTEM_HANDLERS])(void); /* exceptions 1..15 */
	void (*interrupt[IRQ_COUNT])(void);
};
_Static_assert(sizeof(struct vector_table) <= 512, "VTOR's alignment in the linker script");

extern const struct vector_table vectors;
__attribute__((section(".vectors"), used)) const struct vector_table vectors = {
	.stack = stack_top,
	.system = {
		[0] = reset_handler,
		[1 ... TICK - 1] = fault_handler,
		[TICK] = tick_handler,
	},
	.interrupt = {
		[0 ... IRQ_EXTI3 - 1] = fault_handler,
		[IRQ_EXTI3] = gyro_edge_handler,
		[IRQ_EXTI3 + 1 ... IRQ_DMA2_STREAM2 - 1] = fault_handler,
		[IRQ_DMA2_STREAM2] = gyro_sample_handler,
		[IRQ_DMA2_STREAM2 + 1 ... IRQ_COUNT - 1] = fault_handler,
	},
};
