#include "hal/stm32f7/devices/msp_uart.h"

#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/gpio.h"
#include "targets/MATEKF722/board.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/peripherals/uart.h"

#define AF_USART1 7u
#define REPLY_BYTES 1024u
#define SILENCE_MS 200u /* bytes of one request follow each other; after this a new one begins */

static DMA_BUFFER_SLOW uint8_t msp_ring_bytes[UART_RING_BYTES];
static DMA_BUFFER_SLOW uint8_t msp_reply_bytes[REPLY_BYTES];

/* The background's alone. */
static struct uart_ring ring = {.stream = DMA_MSP_RX, .bytes = msp_ring_bytes};
static uint32_t last_byte_ms;

void msp_uart_start(uint32_t baud)
{
	gpio_alternate(BOARD_MSP_TX, AF_USART1, GPIO_PULL_UP, GPIO_SLOW);
	gpio_alternate(BOARD_MSP_RX, AF_USART1, GPIO_PULL_UP, GPIO_SLOW);
	uart_ring_start(&ring, USART1);
	dma_setup(DMA_MSP_TX, &USART_TDR(USART1), DMA_TO_PERIPHERAL, DMA_BYTE, DMA_LOW, 0);
	uart_configure(USART1, CLOCK_APB2_HZ, baud, USART_CR1_RE | USART_CR1_TE, 0,
		       USART_CR3_DMAR | USART_CR3_DMAT);
}

/* The last byte is still in the UART when DMA has handed it over. */
bool msp_uart_sending(void)
{
	return dma_busy(DMA_MSP_TX) || (USART_ISR(USART1) & USART_ISR_TC) == 0u;
}

void msp_uart_serve(const struct hal_handlers *handlers)
{
	uint8_t bytes[64];

	if (dma_busy(DMA_MSP_TX))
		return; /* the reply is still being read */
	const size_t count = uart_ring_read(&ring, bytes, sizeof bytes);
	const uint32_t now = time_ms();

	if (count == 0u)
		return;
	if (now - last_byte_ms > SILENCE_MS)
		handlers->msp_reset(handlers->context);
	last_byte_ms = now;
	const size_t answered = handlers->msp(handlers->context, bytes, count, msp_reply_bytes, sizeof msp_reply_bytes);
	if (answered != 0u)
		dma_start(DMA_MSP_TX, msp_reply_bytes, (uint32_t)answered);
}
