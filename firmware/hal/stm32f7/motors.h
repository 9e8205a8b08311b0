/* Motors 1..4: DShot600 on TIM8 by burst DMA. */
#ifndef STM32F7_MOTORS_H
#define STM32F7_MOTORS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Lines low, timer running, no frame. */
void motors_start(void);

/* Sends one frame to every motor at once (26.7 us); missing values leave their line low. Dropped while the
 * last frame is still on the wire. From the sample handler only. */
void motors_write(const uint16_t dshot[], size_t count);

/* Does DMA still read the frame? */
bool motors_busy(void);

/* Takes the pins from the timer and drives them low, from any state of the chip. */
void motors_force_low(void);

#endif
