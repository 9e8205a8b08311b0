#include "hal/stm32f7/devices/devices.h"

#include "board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/peripherals/uart_line.h"
#include "msp/msp.h"

#define PORTS NF_MSP_PORT_COUNT
#define SILENCE_MS 200u /* bytes of one request follow each other; after this a new one begins */
#define TURNS_MAX 4     /* times that a port's requests are read in one call */
#define REQUEST_BYTES (UART_LINE_SEND_BYTES / MSP_FRAME_MAX * MSP_REQUEST_MIN) /* whose replies fit into a buffer */
_Static_assert(UART_LINE_SEND_BYTES >= 2 * MSP_FRAME_MAX, "room for a reply, and for what is said unasked");

static const struct {
	struct pin tx, rx;
	uint32_t alternate, clock_hz;
} wires[PORTS] = {
	{ BOARD_MSP_TX, BOARD_MSP_RX, BOARD_MSP_AF, BOARD_MSP_UART_HZ },
	{ BOARD_MSP2_TX, BOARD_MSP2_RX, BOARD_MSP2_AF, BOARD_MSP2_UART_HZ },
};

static DMA_BUFFER_SLOW uint8_t msp_rings[PORTS][UART_LINE_RING_BYTES];
static DMA_BUFFER_SLOW uint8_t msp_buffers[PORTS][2][UART_LINE_SEND_BYTES];

/* The background's alone. */
static struct port {
	struct uart_line line;
	uint32_t last_byte_ms;
	bool started;
} ports[PORTS] = {
	{ .line = { .uart = BOARD_MSP_UART,
		    .rx = BOARD_MSP_DMA_RX,
		    .tx = BOARD_MSP_DMA_TX,
		    .ring = msp_rings[0],
		    .buffers = msp_buffers[0] } },
	{ .line = { .uart = BOARD_MSP2_UART,
		    .rx = BOARD_MSP2_DMA_RX,
		    .tx = BOARD_MSP2_DMA_TX,
		    .ring = msp_rings[1],
		    .buffers = msp_buffers[1] } },
};

struct uart_line *msp_uart_lend(unsigned port, uint32_t baud)
{
	gpio_alternate(wires[port].tx, wires[port].alternate, GPIO_PULL_UP, GPIO_SLOW);
	gpio_alternate(wires[port].rx, wires[port].alternate, GPIO_PULL_UP, GPIO_SLOW);
	uart_line_start(&ports[port].line, wires[port].clock_hz, baud);
	return &ports[port].line;
}

void msp_uart_start(unsigned port, uint32_t baud)
{
	(void)msp_uart_lend(port, baud);
	ports[port].started = true;
}

/* Reads received bytes and reports losses and pauses. */
static void msp_uart_look(unsigned number, const struct hal_handlers *handlers)
{
	struct port *port = &ports[number];
	const uint32_t waited = uart_line_waiting(&port->line), now = time_ms();

	if (!uart_line_look(&port->line))
		handlers->link_lost(handlers->context, number);
	else if (uart_line_waiting(&port->line) == waited)
		return;
	/* Where bytes still waited, nobody knows which of them came before the pause. */
	else if (waited == 0u && now - port->last_byte_ms > SILENCE_MS)
		handlers->link_pause(handlers->context, number);
	port->last_byte_ms = now;
}

/* Reads requests whose replies are sure to fit. Returns false if there are none. */
static bool msp_uart_answer(unsigned number, const struct hal_handlers *handlers)
{
	struct uart_line *line = &ports[number].line;
	uint8_t bytes[REQUEST_BYTES];
	size_t room;

	if (handlers->link_busy(handlers->context, number))
		return false;
	uint8_t *reply = uart_line_room(line, &room);
	const size_t count = uart_line_read(line, bytes, room / MSP_FRAME_MAX * MSP_REQUEST_MIN);

	if (count == 0u)
		return false;
	uart_line_fill(line, handlers->link(handlers->context, number, bytes, count, reply, room));
	return true;
}

/* Unsolicited output leaves room for a reply, so that requests are always answered. */
static void msp_uart_speak(unsigned number, const struct hal_handlers *handlers)
{
	struct uart_line *line = &ports[number].line;
	size_t room;
	uint8_t *words = uart_line_room(line, &room);

	if (room > MSP_FRAME_MAX)
		uart_line_fill(line, handlers->link(handlers->context, number, NULL, 0, words, room - MSP_FRAME_MAX));
}

void msp_uart_serve(const struct hal_handlers *handlers)
{
	for (unsigned number = 0; number < PORTS; ++number) {
		if (!ports[number].started)
			continue;
		msp_uart_look(number, handlers);
		uart_line_send(&ports[number].line);
		for (int turn = 0; turn < TURNS_MAX && msp_uart_answer(number, handlers); ++turn)
			uart_line_send(&ports[number].line);
		msp_uart_speak(number, handlers);
		uart_line_send(&ports[number].line);
	}
}

bool msp_uart_finish(void)
{
	bool sending = false;

	for (unsigned number = 0; number < PORTS; ++number) {
		if (!ports[number].started)
			continue;
		uart_line_send(&ports[number].line);
		sending |= uart_line_sending(&ports[number].line);
	}
	return sending;
}
