#include "hal/stm32f7/devices/devices.h"

#include "board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/peripherals/uart_line.h"
#include "msp/msp.h"

#define UARTS 2u
_Static_assert(UART_LINE_SEND_BYTES >= 2 * MSP_FRAME_MAX, "room for a reply, and for what is said unasked");

static const struct {
	struct pin tx, rx;
	uint32_t alternate, clock_hz;
} wires[UARTS] = {
	{ BOARD_MSP_TX, BOARD_MSP_RX, BOARD_MSP_AF, BOARD_MSP_UART_HZ },
	{ BOARD_MSP2_TX, BOARD_MSP2_RX, BOARD_MSP2_AF, BOARD_MSP2_UART_HZ },
};

static DMA_BUFFER_SLOW uint8_t msp_rings[UARTS][UART_LINE_RING_BYTES];
static DMA_BUFFER_SLOW uint8_t msp_buffers[UARTS][2][UART_LINE_SEND_BYTES];

/* The background's alone. */
static struct uart_line uarts[UARTS] = {
	{ .uart = BOARD_MSP_UART,
	  .rx = BOARD_MSP_DMA_RX,
	  .tx = BOARD_MSP_DMA_TX,
	  .ring = msp_rings[0],
	  .buffers = msp_buffers[0] },
	{ .uart = BOARD_MSP2_UART,
	  .rx = BOARD_MSP2_DMA_RX,
	  .tx = BOARD_MSP2_DMA_TX,
	  .ring = msp_rings[1],
	  .buffers = msp_buffers[1] },
};

struct serial_line msp_uart_open(unsigned number, uint32_t baud)
{
	gpio_alternate(wires[number].tx, wires[number].alternate, GPIO_PULL_UP, GPIO_SLOW);
	gpio_alternate(wires[number].rx, wires[number].alternate, GPIO_PULL_UP, GPIO_SLOW);
	return uart_line_start(&uarts[number], wires[number].clock_hz, baud);
}
