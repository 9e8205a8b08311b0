#include "hal/stm32f7/core/gpio.h"

#include "hal/stm32f7/core/core.h"

/* Replaces the `width` bits of pin `number` in a register that packs its pins from bit 0. Interrupts are off meanwhile:
 * those of the motors change modes of the same ports. */
static void gpio_set_field(volatile uint32_t *reg, uint32_t number, uint32_t width, uint32_t value)
{
	const uint32_t mask = BITS(number * width, width), held = interrupts_hold();

	*reg = (*reg & ~mask) | FIELD(mask, value);
	interrupts_release(held);
}

void gpio_start(void)
{
	RCC_AHB1ENR |= RCC_AHB1ENR_GPIOAEN | RCC_AHB1ENR_GPIOBEN | RCC_AHB1ENR_GPIOCEN | RCC_AHB1ENR_GPIODEN |
		       RCC_AHB1ENR_GPIOEEN;
	(void)RCC_AHB1ENR; /* a peripheral answers two cycles after its clock bit (RM0431 5.2.12) */
}

void gpio_mode(struct pin pin, enum gpio_mode mode)
{
	if (pin.port == 0u)
		return;
	gpio_set_field(&GPIO_MODER(pin.port), pin.number, 2, mode);
}

void gpio_input(struct pin pin, enum gpio_pull pull)
{
	if (pin.port == 0u)
		return;
	gpio_set_field(&GPIO_PUPDR(pin.port), pin.number, 2, pull);
	gpio_mode(pin, GPIO_INPUT);
}

void gpio_output(struct pin pin, bool high)
{
	gpio_drive(pin, high, GPIO_FLOATING, GPIO_SLOW);
}

void gpio_drive(struct pin pin, bool high, enum gpio_pull pull, enum gpio_speed speed)
{
	if (pin.port == 0u)
		return;
	gpio_write(pin, high);
	gpio_set_field(&GPIO_OTYPER(pin.port), pin.number, 1, 0);
	gpio_set_field(&GPIO_OSPEEDR(pin.port), pin.number, 2, speed);
	gpio_set_field(&GPIO_PUPDR(pin.port), pin.number, 2, pull);
	gpio_mode(pin, GPIO_OUTPUT);
}

void gpio_alternate(struct pin pin, uint32_t function, enum gpio_pull pull, enum gpio_speed speed)
{
	if (pin.port == 0u)
		return;
	volatile uint32_t *const select = pin.number < 8u ? &GPIO_AFRL(pin.port) : &GPIO_AFRH(pin.port);

	gpio_set_field(select, pin.number % 8u, 4, function);
	gpio_set_field(&GPIO_OTYPER(pin.port), pin.number, 1, 0);
	gpio_set_field(&GPIO_OSPEEDR(pin.port), pin.number, 2, speed);
	gpio_set_field(&GPIO_PUPDR(pin.port), pin.number, 2, pull);
	gpio_mode(pin, GPIO_ALTERNATE);
}
