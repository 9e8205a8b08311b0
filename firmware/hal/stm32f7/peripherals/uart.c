#include "hal/stm32f7/peripherals/uart.h"

#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/registers.h"

struct uart uart_of(const struct board_uart *told)
{
	static const struct uart uarts[] = {
		{ USART1, CLOCK_APB2_HZ }, { USART2, CLOCK_APB1_HZ }, { USART3, CLOCK_APB1_HZ },
		{ UART4, CLOCK_APB1_HZ },  { UART5, CLOCK_APB1_HZ },  { USART6, CLOCK_APB2_HZ },
	};
	const uint32_t index = told->number - 1u;

	if (index >= sizeof uarts / sizeof uarts[0] || stream_of(told->dma_rx).at == 0u)
		return (struct uart){ 0 };
	return uarts[index];
}

void uart_configure(struct uart uart, uint32_t baud, uint32_t cr1, uint32_t cr2, uint32_t cr3)
{
	USART_BRR(uart.at) = (uart.clock_hz + baud / 2u) / baud; /* 16 samples a bit (RM0431 USART, baud rate) */
	USART_CR2(uart.at) = cr2;
	/* DMA takes every byte in time; without overrun detection reception never stops. */
	USART_CR3(uart.at) = cr3 | USART_CR3_OVRDIS;
	USART_CR1(uart.at) = cr1;
	USART_CR1(uart.at) = cr1 | USART_CR1_UE;
}

void uart_ring_start(const struct uart_ring *ring, struct uart uart)
{
	dma_setup(ring->stream, &USART_RDR(uart.at), DMA_FROM_PERIPHERAL, DMA_BYTE, DMA_LOW, DMA_SCR_CIRC);
	dma_start(ring->stream, ring->bytes, UART_RING_BYTES);
}

static inline void uart_copy(uint8_t *to, const volatile uint8_t *from, size_t count)
{
	for (const uint8_t *const end = to + count; to != end;)
		*to++ = *from++;
}

size_t uart_ring_read(struct uart_ring *ring, uint8_t *bytes, size_t capacity)
{
	const uint32_t head = (UART_RING_BYTES - dma_remaining(ring->stream)) % UART_RING_BYTES;
	const size_t waiting = (head - ring->tail) % UART_RING_BYTES;
	const size_t count = waiting < capacity ? waiting : capacity;
	const size_t before_end = UART_RING_BYTES - ring->tail;
	const size_t first = count < before_end ? count : before_end;

	barrier();
	uart_copy(bytes, ring->bytes + ring->tail, first);
	uart_copy(bytes + first, ring->bytes, count - first);
	ring->tail = (ring->tail + (uint32_t)count) % UART_RING_BYTES;
	return count;
}
