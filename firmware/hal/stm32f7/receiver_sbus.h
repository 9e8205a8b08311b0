/* The SBUS line on USART2: inverted, 100 kbaud, 8 data bits, even parity, 2 stop bits. */
#ifndef STM32F7_RECEIVER_SBUS_H
#define STM32F7_RECEIVER_SBUS_H

#include <stddef.h>
#include <stdint.h>

void receiver_sbus_start(void);

/* Bytes since the last call, at most `capacity`. SBUS has no checksum, so a parity or framing error throws
 * away what came with it and the rest of its frame. From the sample handler only. */
size_t receiver_sbus_read(uint8_t *bytes, size_t capacity);

#endif
