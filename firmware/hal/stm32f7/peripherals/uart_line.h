/* A UART that talks both ways: receives into a ring by circular DMA, sends one of two buffers by DMA while the other is
 * being filled, without an interrupt of its own. Background only. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hal/stm32f7/peripherals/dma.h"

#define UART_LINE_RING_BYTES 4096u /* 356 ms at 115200 baud, 44 ms at 921600; input waits there while output does */
#define UART_LINE_SEND_BYTES 1024u

struct uart_line {
	uint32_t uart;
	struct dma_stream rx, tx;
	volatile uint8_t *ring; /* [UART_LINE_RING_BYTES], a DMA_BUFFER_SLOW */
	uint8_t (*buffers)[UART_LINE_SEND_BYTES]; /* [2], likewise */
	uint32_t head; /* bytes received since the start, as last looked at */
	uint32_t tail; /* and those of them that were read or lost */
	uint32_t filling; /* the buffer that DMA does not send, 0 or 1 */
	size_t filled; /* bytes in it */
};

/* 8N1 both ways. The pins are set up; what came before is lost. */
void uart_line_start(struct uart_line *line, uint32_t clock_hz, uint32_t baud);

/* Looks what has come. False: bytes may be lost, as more than half a ring came since the last look, or more than a ring
 * since the last read; then all that waited is gone too. Look at least every UART_LINE_RING_BYTES / 2 bytes' time. */
bool uart_line_look(struct uart_line *line);

/* Bytes that wait to be read, as last looked at. */
uint32_t uart_line_waiting(const struct uart_line *line);

/* Takes received bytes, oldest first, at most `capacity`. */
size_t uart_line_read(struct uart_line *line, uint8_t *bytes, size_t capacity);

/* Where the next bytes to be sent go; *room: how many. */
uint8_t *uart_line_room(const struct uart_line *line, size_t *room);

/* `count` of them were put there. */
void uart_line_fill(struct uart_line *line, size_t count);

/* Sends what was put there, unless the last buffer is still on its way. */
void uart_line_send(struct uart_line *line);

/* Is anything on its way, its last bit not yet on the line? */
bool uart_line_sending(const struct uart_line *line);
