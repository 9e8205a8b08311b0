/* Motors 1..6 by DShot: DMA writes a bit's pulse widths to the timers at each bit's begin. */
#ifndef STM32F7_MOTORS_H
#define STM32F7_MOTORS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Timers running, no frame yet. `protocol`: NF_MOTOR_PROTOCOL_...; `count`: motors in use, at most
 * BOARD_MOTOR_COUNT; the lines of the others stay low. Once, after motor_pins_start. */
void motors_run(uint32_t protocol, size_t count);

/* As motors_write of struct hal: sends one frame to every motor in use (26.7 us with DShot600); missing
 * values send a stop. Dropped while the last frame is still on the wire, and before motors_run; at the fourth write
 * in a row that it would be, the output has stuck and is set up anew. From the sample handler or the tick only. */
void motors_write(void *context, const uint16_t dshot[], size_t count, bool telemetry);

/* As motor_restarts of struct hal: how often outputs that had stuck were set up anew since boot. */
uint32_t motors_restarts(void *context);
#endif
