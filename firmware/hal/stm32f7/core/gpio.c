#include "hal/stm32f7/core/gpio.h"

/* Replaces the `width` bits of pin `number` in a register that packs its pins from bit 0. */
static void gpio_set_field(volatile uint32_t *reg, uint32_t number, uint32_t width, uint32_t value)
{
	const uint32_t mask = BITS(number * width, width);

	*reg = (*reg & ~mask) | FIELD(mask, value);
}

void gpio_mode(struct pin pin, enum gpio_mode mode)
{
	gpio_set_field(&GPIO_MODER(pin.port), pin.number, 2, mode);
}

void gpio_input(struct pin pin, enum gpio_pull pull)
{
	gpio_set_field(&GPIO_PUPDR(pin.port), pin.number, 2, pull);
	gpio_mode(pin, GPIO_INPUT);
}

void gpio_output(struct pin pin, bool high)
{
	gpio_write(pin, high);
	gpio_set_field(&GPIO_OTYPER(pin.port), pin.number, 1, 0);
	gpio_set_field(&GPIO_PUPDR(pin.port), pin.number, 2, GPIO_FLOATING);
	gpio_mode(pin, GPIO_OUTPUT);
}

void gpio_alternate(struct pin pin, uint32_t function, enum gpio_pull pull, enum gpio_speed speed)
{
	volatile uint32_t *const select = pin.number < 8u ? &GPIO_AFRL(pin.port) : &GPIO_AFRH(pin.port);

	gpio_set_field(select, pin.number % 8u, 4, function);
	gpio_set_field(&GPIO_OTYPER(pin.port), pin.number, 1, 0);
	gpio_set_field(&GPIO_OSPEEDR(pin.port), pin.number, 2, speed);
	gpio_set_field(&GPIO_PUPDR(pin.port), pin.number, 2, pull);
	gpio_mode(pin, GPIO_ALTERNATE);
}
