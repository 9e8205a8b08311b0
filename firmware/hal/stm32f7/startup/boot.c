/* The boot part in sector 0: starts the image bank. There is no choice of banks yet, so it is bank A.
 *
 * Runs from reset on its own: no .data, no .bss, nothing from the image's bank. */
#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/registers.h"

/* Linker script. */
extern uint32_t stack_top[];
extern const uint32_t bank_a_start[], bank_a_end[];
extern uint32_t dtcm_start[], dtcm_end[];

void boot_reset(void);
void boot_fault(void);

extern void (*const boot_vectors[])(void);

struct bank_head {
	uint32_t stack;
	uint32_t reset;
};

/* Erased or half-written flash has no valid head of a vector table. */
static bool boot_is_image(const struct bank_head *head)
{
	return head->stack > (uint32_t)dtcm_start && head->stack <= (uint32_t)dtcm_end && head->stack % 8u == 0u &&
	       head->reset > (uint32_t)bank_a_start && head->reset < (uint32_t)bank_a_end && head->reset % 2u == 1u;
}

/* No image, or a fault before it took over: LED0 lit for ever. Motor pins are inputs since reset. */
void boot_fault(void)
{
	const struct pin led = BOARD_LED0;

	RCC_AHB1ENR |= BOARD_PORT_CLOCKS;
	(void)RCC_AHB1ENR;
	gpio_write(led, false);
	GPIO_MODER(led.port) = (GPIO_MODER(led.port) & ~BITS(2u * led.number, 2)) |
			       FIELD(BITS(2u * led.number, 2), GPIO_OUTPUT);
	for (;;)
		__asm volatile("wfi");
}

void boot_reset(void)
{
	const struct bank_head *const head = (const struct bank_head *)bank_a_start;

	if (!boot_is_image(head))
		boot_fault();
	SCB_VTOR = (uint32_t)bank_a_start;
	__asm volatile("dsb\n\t"
		       "isb\n\t"
		       "msr msp, %0\n\t"
		       "bx %1" ::"r"(head->stack),
		       "r"(head->reset));
	__builtin_unreachable();
}

/* Reset, NMI and the faults are all that can happen before VTOR moves to the bank. */
__attribute__((section(".boot_vectors"), used)) void (*const boot_vectors[])(void) = {
	(void (*)(void))stack_top, boot_reset, boot_fault, boot_fault, boot_fault, boot_fault, boot_fault,
};
