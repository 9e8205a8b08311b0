#include "hal/stm32f7/peripherals/uart_line.h"

#include "hal/stm32f7/core/registers.h"

_Static_assert((UART_LINE_RING_BYTES & (UART_LINE_RING_BYTES - 1u)) == 0u, "counts of bytes wrap at 2^32");

/* DMA passes the middle and the end of the ring once a round. Where it passed both since the last look, nobody knows how
 * often; where it passed one at most, the place where it stands tells how many bytes came. */
static enum serial_news uart_line_look(void *context)
{
	struct uart_line *const line = context;
	const uint32_t at = UART_LINE_RING_BYTES - dma_remaining(line->rx);
	const uint32_t passed = dma_take_flags(line->rx, DMA_LISR_HTIF0 | DMA_LISR_TCIF0);

	line->head += (at - line->head) % UART_LINE_RING_BYTES;
	if (passed != (DMA_LISR_HTIF0 | DMA_LISR_TCIF0) && line->head - line->tail <= UART_LINE_RING_BYTES)
		return SERIAL_LINE_GOOD;
	line->tail = line->head;
	return SERIAL_LINE_LOST;
}

static size_t uart_line_waiting(const void *context)
{
	const struct uart_line *const line = context;

	return line->head - line->tail;
}

static size_t uart_line_read(void *context, uint8_t *bytes, size_t capacity)
{
	struct uart_line *const line = context;
	const size_t waiting = uart_line_waiting(line);
	const size_t count = waiting < capacity ? waiting : capacity;

	barrier();
	for (size_t i = 0; i < count; ++i)
		bytes[i] = line->ring[line->tail++ % UART_LINE_RING_BYTES];
	return count;
}

static uint8_t *uart_line_room(const void *context, size_t *room)
{
	const struct uart_line *const line = context;

	*room = UART_LINE_SEND_BYTES - line->filled;
	return line->buffers[line->filling] + line->filled;
}

static void uart_line_fill(void *context, size_t count)
{
	struct uart_line *const line = context;

	line->filled += count;
}

static void uart_line_send(void *context)
{
	struct uart_line *const line = context;

	if (line->filled == 0u || dma_busy(line->tx))
		return;
	dma_start(line->tx, line->buffers[line->filling], (uint32_t)line->filled);
	line->filling ^= 1u;
	line->filled = 0;
}

/* The last byte is still in the UART when DMA has handed it over. */
static bool uart_line_sending(const void *context)
{
	const struct uart_line *const line = context;

	return line->filled != 0u || dma_busy(line->tx) || (USART_ISR(line->uart.at) & USART_ISR_TC) == 0u;
}

struct serial_line uart_line_start(struct uart_line *line, uint32_t baud)
{
	const struct uart uart = line->uart;

	dma_setup(line->rx, &USART_RDR(uart.at), DMA_FROM_PERIPHERAL, DMA_BYTE, DMA_LOW, DMA_SCR_CIRC);
	dma_start(line->rx, line->ring, UART_LINE_RING_BYTES);
	dma_setup(line->tx, &USART_TDR(uart.at), DMA_TO_PERIPHERAL, DMA_BYTE, DMA_LOW, 0);
	uart_configure(uart, baud, USART_CR1_RE | USART_CR1_TE, 0, USART_CR3_DMAR | USART_CR3_DMAT);
	return (struct serial_line){
		.context = line,
		.look = uart_line_look,
		.waiting = uart_line_waiting,
		.read = uart_line_read,
		.room = uart_line_room,
		.fill = uart_line_fill,
		.send = uart_line_send,
		.sending = uart_line_sending,
	};
}
