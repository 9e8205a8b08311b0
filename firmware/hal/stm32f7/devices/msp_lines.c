#include "hal/stm32f7/devices/devices.h"

#include "hal/stm32f7/core/time.h"
#include "msp/msp.h"

#define PORTS NF_MSP_PORT_COUNT
#define SILENCE_MS 200u /* bytes of one request follow each other; after this a new one begins */
#define TURNS_MAX 4     /* times that a port's requests are read in one call */
#define REQUEST_BYTES \
	(1024u / MSP_FRAME_MAX * MSP_REQUEST_MIN) /* read at once, where a line has room for all replies */

/* The background's alone. */
static struct port {
	struct serial_line line;
	uint32_t last_byte_ms;
	bool started;
} ports[PORTS];

void msp_lines_start(unsigned port, struct serial_line line)
{
	ports[port].line = line;
	ports[port].started = true;
}

/* Reads received bytes and reports losses and pauses. */
static void msp_lines_look(unsigned number, const struct hal_handlers *handlers)
{
	struct port *port = &ports[number];
	const struct serial_line *const line = &port->line;
	const size_t waited = line->waiting(line->context);
	const enum serial_news news = line->look(line->context);
	const uint32_t now = time_ms();

	if (news == SERIAL_LINE_NEW)
		handlers->link_reset(handlers->context, number);
	else if (news == SERIAL_LINE_LOST)
		handlers->link_lost(handlers->context, number);
	else if (line->waiting(line->context) == waited)
		return;
	/* Where bytes still waited, nobody knows which of them came before the pause. */
	else if (waited == 0u && now - port->last_byte_ms > SILENCE_MS)
		handlers->link_pause(handlers->context, number);
	port->last_byte_ms = now;
}

/* Reads requests whose replies are sure to fit. Returns false if there are none. */
static bool msp_lines_answer(unsigned number, const struct hal_handlers *handlers)
{
	const struct serial_line *const line = &ports[number].line;
	uint8_t bytes[REQUEST_BYTES];
	size_t room;

	if (handlers->link_busy(handlers->context, number))
		return false;
	uint8_t *reply = line->room(line->context, &room);
	const size_t most = room / MSP_FRAME_MAX * MSP_REQUEST_MIN;
	const size_t count = line->read(line->context, bytes, most < sizeof bytes ? most : sizeof bytes);

	if (count == 0u)
		return false;
	line->fill(line->context, handlers->link(handlers->context, number, bytes, count, reply, room));
	return true;
}

/* Unsolicited output leaves room for a reply, so that requests are always answered. */
static void msp_lines_speak(unsigned number, const struct hal_handlers *handlers)
{
	const struct serial_line *const line = &ports[number].line;
	size_t room;
	uint8_t *words = line->room(line->context, &room);

	if (room > MSP_FRAME_MAX)
		line->fill(line->context,
			   handlers->link(handlers->context, number, NULL, 0, words, room - MSP_FRAME_MAX));
}

void msp_lines_serve(const struct hal_handlers *handlers)
{
	for (unsigned number = 0; number < PORTS; ++number) {
		const struct serial_line *const line = &ports[number].line;

		if (!ports[number].started)
			continue;
		msp_lines_look(number, handlers);
		line->send(line->context);
		for (int turn = 0; turn < TURNS_MAX && msp_lines_answer(number, handlers); ++turn)
			line->send(line->context);
		msp_lines_speak(number, handlers);
		line->send(line->context);
	}
}

bool msp_lines_finish(void)
{
	bool sending = false;

	for (unsigned number = 0; number < PORTS; ++number) {
		const struct serial_line *const line = &ports[number].line;

		if (!ports[number].started)
			continue;
		line->send(line->context);
		sending |= line->sending(line->context);
	}
	return sending;
}
