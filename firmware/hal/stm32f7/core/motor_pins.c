#include "hal/stm32f7/core/motor_pins.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/registers.h"

void motor_pins_start(void)
{
	for (size_t i = 0; i < board.motor_count && i < NF_MOTOR_COUNT_MAX; ++i)
		gpio_output(pin_of(board.motor_pins[i]), false);
}

void motor_pins_connect(size_t count, bool rest_high)
{
	for (size_t i = 0; i < count; ++i)
		gpio_drive(pin_of(board.motor_pins[i]), rest_high, rest_high ? GPIO_PULL_UP : GPIO_PULL_DOWN,
			   GPIO_MEDIUM);
}

/* DMA would go on writing the rest of a frame to the ports: nobody asks it for that any more. */
void motor_pins_force_low(void)
{
	gpio_start();
	RCC_APB2ENR |= RCC_APB2ENR_TIM1EN;
	(void)RCC_APB2ENR;
	TIM_DIER(TIM1) = 0;
	(void)TIM_DIER(TIM1);
	barrier();
	motor_pins_start();
}
