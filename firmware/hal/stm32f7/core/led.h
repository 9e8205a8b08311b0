/* The board's LED; a board without one leaves it at that. */
#pragma once

#include <stdbool.h>

/* An output from now on, dark. Needs its port's clock (gpio_start). */
void led_start(void);
void led_light(bool lit);
