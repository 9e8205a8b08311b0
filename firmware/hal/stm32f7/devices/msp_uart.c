#include "hal/stm32f7/devices/devices.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/peripherals/uart_line.h"
#include "msp/msp.h"

#define UARTS 2u
_Static_assert(UART_LINE_SEND_BYTES >= 2 * MSP_FRAME_MAX, "room for a reply, and for what is said unasked");

static DMA_BUFFER_SLOW uint8_t msp_rings[UARTS][UART_LINE_RING_BYTES];
static DMA_BUFFER_SLOW uint8_t msp_buffers[UARTS][2][UART_LINE_SEND_BYTES];

/* The background's alone. */
static struct uart_line uarts[UARTS];

bool msp_uart_open(unsigned number, uint32_t baud, struct serial_line *line)
{
	const struct board_uart *const told = number == 0u ? &board.msp : &board.second;
	struct uart_line *const uart = &uarts[number];

	uart->uart = uart_of(told);
	uart->rx = stream_of(told->dma_rx);
	uart->tx = stream_of(told->dma_tx);
	uart->ring = msp_rings[number];
	uart->buffers = msp_buffers[number];
	if (uart->uart.at == 0u || uart->tx.at == 0u)
		return false;
	gpio_alternate(pin_of(told->tx), told->tx_function, GPIO_PULL_UP, GPIO_SLOW);
	gpio_alternate(pin_of(told->rx), told->rx_function, GPIO_PULL_UP, GPIO_SLOW);
	*line = uart_line_start(uart, baud);
	return true;
}
