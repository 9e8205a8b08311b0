/* The vector table of the image (ARMv7-M B1.5.2, RM0431 chapter NVIC). It heads the bank, where the boot part finds it;
 * start-up copies it to ITCM. */
#include <stdint.h>

#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/registers.h"

extern uint32_t stack_top[]; /* linker script */

#define SYSTEM_HANDLERS 15
enum { LATER = 13, TICK = 14 }; /* exceptions 14, PendSV, and 15 */

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
		[1 ... LATER - 1] = fault_handler,
		[LATER] = motors_answers_handler,
		[TICK] = tick_handler,
	},
	.interrupt = {
		/* Of those of the gyro a board enables one each, by where it has the chip. */
		[0 ... IRQ_EXTI0 - 1] = fault_handler,
		[IRQ_EXTI0 ... IRQ_EXTI4] = gyro_edge_handler,
		[IRQ_DMA1_STREAM0] = gyro_sample_handler, /* SPI3 */
		[IRQ_DMA1_STREAM1] = fault_handler,
		[IRQ_DMA1_STREAM2] = gyro_sample_handler, /* SPI3 */
		[IRQ_DMA1_STREAM3] = gyro_sample_handler, /* SPI2 */
		[IRQ_DMA1_STREAM4 ... IRQ_EXTI9_5 - 1] = fault_handler,
		[IRQ_EXTI9_5] = gyro_edge_handler,
		[IRQ_EXTI9_5 + 1 ... IRQ_EXTI15_10 - 1] = fault_handler,
		[IRQ_EXTI15_10] = gyro_edge_handler,
		[IRQ_EXTI15_10 + 1 ... IRQ_TIM5 - 1] = fault_handler,
		[IRQ_TIM5] = gyro_edge_handler,
		[IRQ_TIM5 + 1 ... IRQ_DMA2_STREAM0 - 1] = fault_handler,
		[IRQ_DMA2_STREAM0] = gyro_sample_handler, /* SPI1 */
		[IRQ_DMA2_STREAM1] = motors_moved_handler, /* TIM1, as 3, 4 and 6; one of them is enabled */
		[IRQ_DMA2_STREAM2] = gyro_sample_handler, /* SPI1 */
		[IRQ_DMA2_STREAM3] = motors_moved_handler,
		[IRQ_DMA2_STREAM4] = motors_moved_handler,
		[IRQ_DMA2_STREAM4 + 1 ... IRQ_DMA2_STREAM6 - 1] = fault_handler,
		[IRQ_DMA2_STREAM6] = motors_moved_handler,
		[IRQ_DMA2_STREAM6 + 1 ... IRQ_COUNT - 1] = fault_handler,
	},
};
