/* The pins of the motors: low, or connected to their timers. GPIO only, so that a fault can stop the motors. */
#pragma once

#include <stddef.h>

/* Drives all motor lines low. The ports' clocks must run. */
void motor_pins_start(void);

/* Connects the first `count` motors, at most BOARD_MOTOR_COUNT, to their timers. */
void motor_pins_connect(size_t count);

/* Disconnects all motors from their timers and drives the lines low, whatever state the chip is in. */
void motor_pins_force_low(void);
