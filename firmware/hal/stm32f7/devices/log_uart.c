#include "hal/stm32f7/devices/devices.h"

#include <string.h>

#include "port/serial_line.h"

#define PORT 1u

static struct serial_line line;
static uint8_t state; /* enum nf_log_state */

static void log_uart_step(void *context)
{
	line.send(line.context);
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
		uint8_t *const there = line.room(line.context, &room);
		const size_t part = count - taken < room ? count - taken : room;

		memcpy(there, bytes + taken, part);
		line.fill(line.context, part);
		taken += part;
		line.send(line.context);
	}
	return taken;
}

static enum log_answer log_uart_end(void *context)
{
	line.send(line.context);
	state = line.sending(line.context) ? NF_LOG_STATE_ENDING : NF_LOG_STATE_READY;
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
	if (!msp_uart_open(PORT, baud, &line))
		return NULL;
	state = NF_LOG_STATE_READY;
	return &device;
}
