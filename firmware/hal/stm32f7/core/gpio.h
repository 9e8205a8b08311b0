/* Pins: set up once, written any time. The port's clock must run (gpio_start). A pin that a board does not have is left
 * alone by all of them. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "hal/stm32f7/core/registers.h"

struct pin {
	uint32_t port; /* GPIOA..; 0: no pin */
	uint32_t number; /* 0..15 */
};

#define GPIO_PORTS 5u /* A to E: port H has the crystal, and no board more */
#define GPIO_PORT_STEP (GPIOB - GPIOA)

/* The pin that a board's description calls `code`. */
static inline struct pin pin_of(uint8_t code)
{
	const uint32_t port = code >> 4;

	return port < GPIO_PORTS ? (struct pin){ GPIOA + GPIO_PORT_STEP * port, code & 0xFu } : (struct pin){ 0, 0 };
}

/* Values of the GPIO registers' two-bit fields (RM0431 chapter 6). */
enum gpio_mode { GPIO_INPUT = 0, GPIO_OUTPUT = 1, GPIO_ALTERNATE = 2, GPIO_ANALOG = 3 };
enum gpio_pull { GPIO_FLOATING = 0, GPIO_PULL_UP = 1, GPIO_PULL_DOWN = 2 };
enum gpio_speed { GPIO_SLOW = 0, GPIO_MEDIUM = 1, GPIO_FAST = 2 };

/* Drives the pin high or low; only matters in GPIO_OUTPUT. One store, safe from any context. */
static inline void gpio_write(struct pin pin, bool high)
{
	if (pin.port != 0u)
		GPIO_BSRR(pin.port) = 1u << (pin.number + (high ? 0u : 16u));
}

/* What it reads; `without` where there is no pin. */
static inline bool gpio_read(struct pin pin, bool without)
{
	return pin.port == 0u ? without : (GPIO_IDR(pin.port) >> pin.number & 1u) != 0u;
}

/* Runs the clocks of all ports. Any context. */
void gpio_start(void);

/* The mode alone; the last step of a set-up, so that a pin never shows a half-made one. */
void gpio_mode(struct pin pin, enum gpio_mode mode);
void gpio_input(struct pin pin, enum gpio_pull pull);
/* Push-pull, starting at `high`. */
void gpio_output(struct pin pin, bool high);
/* The same with the edges of `speed`, and with a pull for when it is an input. */
void gpio_drive(struct pin pin, bool high, enum gpio_pull pull, enum gpio_speed speed);
/* Push-pull (where the peripheral drives), alternate function 0..15. */
void gpio_alternate(struct pin pin, uint32_t function, enum gpio_pull pull, enum gpio_speed speed);
