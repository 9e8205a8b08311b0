#include "hal/stm32f7/core/led.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/gpio.h"

void led_start(void)
{
	gpio_output(pin_of(board.led), board.led_high == 0u);
}

void led_light(bool lit)
{
	gpio_write(pin_of(board.led), lit == (board.led_high != 0u));
}
