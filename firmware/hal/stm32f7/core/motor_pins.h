/* The pins of the motors: low, or at rest between frames. Few registers, so that a fault can stop the motors. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

/* Drives all motor lines low. The ports' clocks must run. */
void motor_pins_start(void);

/* Drives the first `count` motors' lines as frames need it, at most board.motor_count, resting high or low, and pulls them
 * there where nobody drives them. */
void motor_pins_connect(size_t count, bool rest_high);

/* Ends frames and drives all lines low, whatever state the chip is in. */
void motor_pins_force_low(void);
