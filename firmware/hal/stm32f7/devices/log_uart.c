#include "hal/stm32f7/devices/devices.h"

#include <string.h>

#include "hal/stm32f7/peripherals/uart_line.h"

#define PORT 1u

static struct uart_line *line;
static uint8_t state; /* enum nf_log_state */

static void log_uart_step(void *context)
{
	uart_line_send(line);
}

static void log_uart_status(void *context, struct log_device_status *status)
{
	*status = (struct log_device_status){ .state = state };
}

static enum log_answer log_uart_begin(void *context)
{
	state = NF_LOG_STATE_LOGGING;
	return LOG_DONE;
}

/* Into the buffer that DMA does not send. */
static size_t log_uart_write(void *context, const uint8_t *bytes, size_t count)
{
	size_t room, taken = 0;

	for (int buffer = 0; buffer < 2; ++buffer) {
		uint8_t *const there = uart_line_room(line, &room);
		const size_t part = count - taken < room ? count - taken : room;

		memcpy(there, bytes + taken, part);
		uart_line_fill(line, part);
		taken += part;
		uart_line_send(line);
	}
	return taken;
}

static enum log_answer log_uart_end(void *context)
{
	uart_line_send(line);
	state = uart_line_sending(line) ? NF_LOG_STATE_ENDING : NF_LOG_STATE_READY;
	return state == NF_LOG_STATE_READY ? LOG_DONE : LOG_LATER;
}

static const struct log_device device = {
	.step = log_uart_step,
	.status = log_uart_status,
	.begin = log_uart_begin,
	.write = log_uart_write,
	.end = log_uart_end,
};

const struct log_device *log_uart_start(uint32_t baud)
{
	line = msp_uart_lend(PORT, baud);
	state = NF_LOG_STATE_READY;
	return &device;
}
