/* Final stop: motors low, the LED flashes the cause. */
#pragma once

/* Flashes of the LED before each pause. */
enum led_code {
	LED_REFUSED = 3,  /* the core cannot fly with this board's configuration */
	LED_NO_CLOCK = 4, /* PLL, over-drive or cycle counter did not come up */
	LED_FAULT = 5,    /* faults in a row, each before anybody took its record */
};

/* Forces the motor lines low and shows `code` until power-off, feeding the watchdog. Any context, any clock. */
_Noreturn void stop(enum led_code code);
