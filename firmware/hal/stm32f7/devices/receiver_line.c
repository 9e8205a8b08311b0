#include "hal/stm32f7/devices/devices.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/peripherals/uart.h"
#include "nf_contract.h"

#define STOP_BITS_2 2u /* USART_CR2 STOP; 0 is one */

static DMA_BUFFER uint8_t receiver_ring_bytes[UART_RING_BYTES];

/* By NF_RECEIVER_PROTOCOL_...; other protocols do not use this line. */
static const struct format {
	uint32_t baud;
	uint32_t cr1; /* 9 bits a word, where the ninth is the parity (even: PS 0) */
	uint32_t cr2;
	enum gpio_pull rest;   /* the level at rest: without a receiver the line stays silent */
	bool drops_broken;     /* its frames have no checksum of their own */
} formats[] = {
	[NF_RECEIVER_PROTOCOL_SBUS] = {
		.baud = 100000,
		.cr1 = USART_CR1_M0 | USART_CR1_PCE,
		.cr2 = USART_CR2_RXINV | FIELD(USART_CR2_STOP, STOP_BITS_2),
		.rest = GPIO_PULL_DOWN,
		.drops_broken = true,
	},
	[NF_RECEIVER_PROTOCOL_CRSF] = {
		.baud = 416666, /* Crossfire's; ExpressLRS sends at 420000, 0.8 % faster, which 8N1 tolerates */
		.rest = GPIO_PULL_UP,
	},
};

/* Touched by the sample handler alone, once started. */
static struct uart_ring ring = { .bytes = receiver_ring_bytes };
static uint32_t registers; /* of its UART; 0: not started */
static bool drops_broken;
static bool frame_broken; /* drop bytes until the line rests: a frame is sent without a pause in it */

void receiver_line_start(uint32_t protocol)
{
	if (protocol >= sizeof formats / sizeof formats[0])
		return;
	const struct format *const format = &formats[protocol];
	const struct uart uart = uart_of(&board.receiver);

	if (uart.at == 0u)
		return;
	ring.stream = stream_of(board.receiver.dma_rx);
	gpio_alternate(pin_of(board.receiver.rx), board.receiver.rx_function, format->rest, GPIO_SLOW);
	uart_ring_start(&ring, uart);
	uart_configure(uart, format->baud, format->cr1 | USART_CR1_RE, format->cr2, USART_CR3_DMAR);
	drops_broken = format->drops_broken;
	registers = uart.at;
}

/* Is what has just been read part of a frame with a broken byte? */
static bool receiver_line_broken(uint32_t status)
{
	if ((status & (USART_ISR_PE | USART_ISR_FE)) != 0u) {
		USART_ICR(registers) = USART_ICR_PECF | USART_ICR_FECF | USART_ICR_IDLECF;
		frame_broken = true;
		return true;
	}
	if (!frame_broken)
		return false;
	if ((status & USART_ISR_IDLE) != 0u)
		frame_broken = false; /* from the next call on: these bytes still belong to the broken frame */
	return true;
}

size_t receiver_line_read(void *context, uint8_t *bytes, size_t capacity)
{
	if (registers == 0u)
		return 0;
	const uint32_t status = USART_ISR(registers);
	const size_t count = uart_ring_read(&ring, bytes, capacity);

	return drops_broken && receiver_line_broken(status) ? 0 : count;
}
