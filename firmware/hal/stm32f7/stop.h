/* The last resort: motors stopped, and the LED says why. */
#ifndef STM32F7_STOP_H
#define STM32F7_STOP_H

#include <stdbool.h>
#include <stdint.h>

/* Flashes of LED0 before each pause. */
enum led_code {
	LED_RUNNING = 1,
	LED_NO_GYRO = 2,  /* runs and answers MSP, but never arms */
	LED_REFUSED = 3,  /* the core cannot fly with this board's configuration */
	LED_NO_CLOCK = 4, /* crystal, PLL, over-drive or cycle counter did not come up */
	LED_FAULT = 5,    /* an exception nobody expected */
};

/* Is the LED lit at this time of its pattern? */
bool led_lit(enum led_code code, uint32_t ms);

/* Forces the motor lines low and shows `code` until the power goes. Any context, any clock, any stack. */
_Noreturn void stop(enum led_code code);

#endif
