/* The receiver's line: SBUS (inverted, 100 kbaud, 8E2) or CRSF (416,666 baud, 8N1). */
#ifndef STM32F7_RECEIVER_LINE_H
#define STM32F7_RECEIVER_LINE_H

#include <stddef.h>
#include <stdint.h>

/* `protocol`: NF_RECEIVER_PROTOCOL_...; a protocol that does not use the line leaves it off. */
void receiver_line_start(uint32_t protocol);

/* As receiver_read of struct hal: bytes since the last call, at most `capacity`. SBUS has no checksum, so there a
 * parity or framing error discards the bytes read with it and the rest of its frame. From the sample handler only. */
size_t receiver_line_read(void *context, uint8_t *bytes, size_t capacity);

#endif
