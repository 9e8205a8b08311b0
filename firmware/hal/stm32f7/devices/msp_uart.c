#include "hal/stm32f7/devices/msp_uart.h"

#include "board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/peripherals/uart.h"

#define PORT 0u
#define REPLY_BYTES 1024u
#define SILENCE_MS 200u /* bytes of one request follow each other; after this a new one begins */

static DMA_BUFFER_SLOW uint8_t msp_ring_bytes[UART_RING_BYTES];
static DMA_BUFFER_SLOW uint8_t msp_reply_bytes[REPLY_BYTES];

/* The background's alone. */
static struct uart_ring ring = { .stream = BOARD_MSP_DMA_RX, .bytes = msp_ring_bytes };
static uint32_t last_byte_ms;

void msp_uart_start(uint32_t baud)
{
	gpio_alternate(BOARD_MSP_TX, BOARD_MSP_AF, GPIO_PULL_UP, GPIO_SLOW);
	gpio_alternate(BOARD_MSP_RX, BOARD_MSP_AF, GPIO_PULL_UP, GPIO_SLOW);
	uart_ring_start(&ring, BOARD_MSP_UART);
	dma_setup(BOARD_MSP_DMA_TX, &USART_TDR(BOARD_MSP_UART), DMA_TO_PERIPHERAL, DMA_BYTE, DMA_LOW, 0);
	uart_configure(BOARD_MSP_UART, BOARD_MSP_UART_HZ, baud, USART_CR1_RE | USART_CR1_TE, 0,
		       USART_CR3_DMAR | USART_CR3_DMAT);
}

/* The last byte is still in the UART when DMA has handed it over. */
bool msp_uart_sending(void)
{
	return dma_busy(BOARD_MSP_DMA_TX) || (USART_ISR(BOARD_MSP_UART) & USART_ISR_TC) == 0u;
}

void msp_uart_serve(const struct hal_handlers *handlers)
{
	uint8_t bytes[64];

	if (dma_busy(BOARD_MSP_DMA_TX))
		return; /* the reply is still being read */
	const size_t count = uart_ring_read(&ring, bytes, sizeof bytes);
	const uint32_t now = time_ms();

	if (count != 0u && now - last_byte_ms > SILENCE_MS)
		handlers->link_pause(handlers->context, PORT);
	if (count != 0u)
		last_byte_ms = now;
	const size_t answered = handlers->link(handlers->context, PORT, bytes, count, msp_reply_bytes,
					       sizeof msp_reply_bytes);
	if (answered != 0u)
		dma_start(BOARD_MSP_DMA_TX, msp_reply_bytes, (uint32_t)answered);
}
