#include "receiver_sbus.h"

#include "clock.h"
#include "targets/MATEKF722/board.h"
#include "uart.h"

#define AF_USART2 7u
#define BAUD 100000u
#define STOP_BITS_2 2u /* USART_CR2 STOP */

static DMA_BUFFER uint8_t sbus_ring_bytes[UART_RING_BYTES];

/* Touched by the sample handler alone. */
static struct uart_ring ring = {.stream = DMA_RECEIVER_RX, .bytes = sbus_ring_bytes};
static bool frame_broken; /* drop bytes until the line rests: a frame is sent without a pause in it */

void receiver_sbus_start(void)
{
	/* Inverted, the line rests low: without a receiver the pull-down keeps it silent. */
	gpio_alternate(BOARD_RECEIVER_RX, AF_USART2, GPIO_PULL_DOWN, GPIO_SLOW);
	uart_ring_start(&ring, USART2);
	/* 9 bits a word, the ninth being the parity (even: PS 0). */
	uart_configure(USART2, CLOCK_APB1_HZ, BAUD, USART_CR1_M0 | USART_CR1_PCE | USART_CR1_RE,
		       USART_CR2_RXINV | FIELD(USART_CR2_STOP, STOP_BITS_2), USART_CR3_DMAR);
}

size_t receiver_sbus_read(uint8_t *bytes, size_t capacity)
{
	const uint32_t status = USART_ISR(USART2);
	const size_t count = uart_ring_read(&ring, bytes, capacity);

	if ((status & (USART_ISR_PE | USART_ISR_FE)) != 0u) {
		USART_ICR(USART2) = USART_ICR_PECF | USART_ICR_FECF | USART_ICR_IDLECF;
		frame_broken = true;
		return 0;
	}
	if (!frame_broken)
		return count;
	if ((status & USART_ISR_IDLE) != 0u)
		frame_broken = false; /* from the next call on: these bytes still belong to the broken frame */
	return 0;
}
