#include "uart.h"

#include "registers.h"

void uart_configure(uint32_t uart, uint32_t clock_hz, uint32_t baud, uint32_t cr1, uint32_t cr2, uint32_t cr3)
{
	USART_BRR(uart) = (clock_hz + baud / 2u) / baud; /* 16 samples a bit (RM0431 USART, baud rate) */
	USART_CR2(uart) = cr2;
	/* DMA takes every byte in time, and an overrun that stopped reception would need a watcher. */
	USART_CR3(uart) = cr3 | USART_CR3_OVRDIS;
	USART_CR1(uart) = cr1;
	USART_CR1(uart) = cr1 | USART_CR1_UE;
}

void uart_ring_start(const struct uart_ring *ring, uint32_t uart)
{
	dma_setup(ring->stream, &USART_RDR(uart), DMA_FROM_PERIPHERAL, DMA_BYTE, DMA_LOW, DMA_SCR_CIRC);
	dma_start(ring->stream, ring->bytes, UART_RING_BYTES);
}

size_t uart_ring_read(struct uart_ring *ring, uint8_t *bytes, size_t capacity)
{
	const uint32_t head = (UART_RING_BYTES - dma_remaining(ring->stream)) % UART_RING_BYTES;
	size_t count = 0;

	barrier();
	while (ring->tail != head && count < capacity) {
		bytes[count++] = ring->bytes[ring->tail];
		ring->tail = (ring->tail + 1u) % UART_RING_BYTES;
	}
	return count;
}
