#include "hal/stm32f7/core/motor_pins.h"

#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/registers.h"
#include "targets/MATEKF722/board.h"

static const struct motor_pin {
	struct pin pin;
	uint32_t function;
} motor_pins[] = { BOARD_MOTOR_PINS };
_Static_assert(sizeof motor_pins / sizeof motor_pins[0] == BOARD_MOTOR_COUNT, "one pin a motor");

void motor_pins_start(void)
{
	for (size_t i = 0; i < BOARD_MOTOR_COUNT; ++i)
		gpio_output(motor_pins[i].pin, false);
}

void motor_pins_connect(size_t count)
{
	for (size_t i = 0; i < count; ++i)
		gpio_alternate(motor_pins[i].pin, motor_pins[i].function, GPIO_PULL_DOWN, GPIO_MEDIUM);
}

void motor_pins_force_low(void)
{
	RCC_AHB1ENR |= BOARD_PORT_CLOCKS;
	(void)RCC_AHB1ENR; /* a peripheral answers two cycles after its clock bit (RM0431 5.2.12) */
	motor_pins_start();
}
