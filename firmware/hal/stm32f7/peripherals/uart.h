/* UARTs that receive into a ring by circular DMA: no interrupt of their own. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/peripherals/dma.h"

#define UART_RING_BYTES 256u /* 28 ms of SBUS, 6 ms of CRSF */

/* A USART or UART, of `board`'s; at 0: it has none there. */
struct uart {
	uint32_t at;       /* registers */
	uint32_t clock_hz; /* what makes its bits: APB1's or APB2's, as after reset (RCC_DCKCFGR2) */
};
struct uart uart_of(const struct board_uart *told);

struct uart_ring {
	struct dma_stream stream;
	uint32_t tail;                  /* next byte to hand over, 0..UART_RING_BYTES - 1 */
	volatile uint8_t *bytes;        /* UART_RING_BYTES of them, a DMA_BUFFER; DMA writes here */
};

/* Line settings before `USART_CR1_UE`: the UART must be off. `cr1` and `cr2`: parity, word length, stop bits,
 * inversion, directions. */
void uart_configure(struct uart uart, uint32_t baud, uint32_t cr1, uint32_t cr2, uint32_t cr3);

/* Starts filling the ring from `uart`. */
void uart_ring_start(const struct uart_ring *ring, struct uart uart);

/* Takes received bytes, oldest first, at most `capacity`. Bytes that are not taken in time are overwritten. */
size_t uart_ring_read(struct uart_ring *ring, uint8_t *bytes, size_t capacity);
