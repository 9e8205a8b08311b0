/* A UART that talks both ways: receives into a ring by circular DMA, sends one of two buffers by DMA while the other is
 * being filled, without an interrupt of its own. Background only. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hal/stm32f7/peripherals/uart.h"
#include "port/serial_line.h"

#define UART_LINE_RING_BYTES 4096u /* 356 ms at 115200 baud, 44 ms at 921600; input waits there while output does */
#define UART_LINE_SEND_BYTES 1024u

struct uart_line {
	struct uart uart;
	struct dma_stream rx, tx;
	volatile uint8_t *ring; /* [UART_LINE_RING_BYTES], a DMA_BUFFER_SLOW */
	uint8_t (*buffers)[UART_LINE_SEND_BYTES]; /* [2], likewise */
	uint32_t head; /* bytes received since the start, as last looked at */
	uint32_t tail; /* and those of them that were read or lost */
	uint32_t filling; /* the buffer that DMA does not send, 0 or 1 */
	size_t filled; /* bytes in it */
};

/* 8N1 both ways. The pins are set up; what came before is lost. Returns the line, which `line` must outlive. Bytes count as
 * lost where more than half a ring came since the last look, or more than a ring since the last read: look at least every
 * UART_LINE_RING_BYTES / 2 bytes' time. */
struct serial_line uart_line_start(struct uart_line *line, uint32_t baud);
