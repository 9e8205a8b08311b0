#include "msp/msp_port.h"

void msp_port_init(struct msp_port *port, const struct services *services)
{
	*port = (struct msp_port){ .services = services };
	msp_reset(&port->msp);
	command_line_init(&port->command_line, services);
}

void msp_port_reset(struct msp_port *port)
{
	msp_reset(&port->msp);
	command_line_leave(&port->command_line);
	port->hidden = 0;
	port->held = 0;
	(void)port->services->arming(port->services->context, &port->peer, false, false);
	port->peer = (struct msp_peer){ 0 };
}

void msp_port_pause(struct msp_port *port)
{
	msp_reset(&port->msp);
	if (port->hidden > 0)
		command_line_spoil(&port->command_line);
	port->hidden = 0;
}

void msp_port_lost(struct msp_port *port)
{
	msp_reset(&port->msp);
	command_line_lost(&port->command_line);
	port->hidden = 0;
}

/* Writes the reply to the request just read; 0 bytes if it does not fit. */
static size_t msp_port_answer(struct msp_port *port, const struct firmware_status *status, uint8_t *reply,
			      size_t capacity)
{
	const struct services *services = port->services;
	const struct msp *msp = &port->msp;
	uint8_t payload[MSP_REPLY_MAX];
	struct msp_writer writer = { payload, payload + sizeof payload };
	struct msp_request q = {
		.services = services,
		.peer = &port->peer,
		.status = status,
		.settings = services->settings,
		.command = msp->command,
		.payload = { msp->payload, msp->size },
		.reply = &writer,
	};

	services->heard(services->context, &port->peer);
	const bool known = msp_reply(&q) || msp_configure(&q) || msp_command(&q);
	if (q.refusal != NF_REFUSAL_NONE) {
		msp_put_u8(&writer, q.refusal);
		msp_put_u16(&writer, (unsigned)q.detail);
	}
	return msp_frame(msp->version, msp->command, !known || q.refusal != NF_REFUSAL_NONE, payload,
			 (size_t)(writer.at - payload), reply, capacity);
}

/* Writes the stream record that is due. */
static size_t msp_port_speak(struct msp_port *port, uint8_t *words, size_t capacity)
{
	struct control_record record;

	port->services->record(port->services->context, &record);
	return msp_stream_due(&port->peer.stream, record.trace.step) ?
		       msp_stream_write(&port->peer.stream, &record, words, capacity) :
		       0;
}

/* --- The command line ------------------------------------------------------------------------------------------- */
bool msp_port_busy(const struct msp_port *port)
{
	return port->held > 0 || command_line_busy(&port->command_line);
}

/* Returns whether a session is open or its typed bytes are pending. */
static bool msp_port_converses(const struct msp_port *port)
{
	return port->held > 0 || command_line_open(&port->command_line);
}

static void msp_port_hold(struct msp_port *port, uint8_t byte)
{
	if (port->held < MSP_PORT_HOLDS)
		port->holds[(port->held_from + port->held++) % MSP_PORT_HOLDS] = byte;
	else
		msp_port_lost(port);
}

static uint8_t msp_port_release(struct msp_port *port)
{
	const uint8_t byte = port->holds[port->held_from];

	port->held_from = (uint8_t)((port->held_from + 1u) % MSP_PORT_HOLDS);
	--port->held;
	return byte;
}

/* A byte of an open session. At the start of a line what may be a request is kept from the command line until it is
 * known to be none, so that nothing of a request is echoed. A whole request ends the session wherever it comes. */
static size_t msp_port_type(struct msp_port *port, const struct firmware_status *status, uint8_t byte, uint8_t *reply,
			    size_t capacity)
{
	struct command_line *cl = &port->command_line;
	const bool hides = port->hidden > 0 || command_line_at_start(cl);
	size_t written = 0;

	if (msp_push(&port->msp, byte)) {
		port->hidden = 0;
		command_line_leave(cl);
		return msp_port_answer(port, status, reply, capacity);
	}
	if (hides && !msp_idle(&port->msp)) {
		port->hidden = port->hidden == 0 ? 1 : 2;
		command_line_stop(cl);
		return 0;
	}
	if (port->hidden == 1)
		written = command_line_take(cl, '$', reply, capacity);
	else if (port->hidden > 1)
		command_line_spoil(cl);
	port->hidden = 0;
	return written + command_line_take(cl, byte, reply + written, capacity - written);
}

/* Opens a command line session if the byte is one that opens it; returns the bytes of its reply. Streaming stops
 * during a session. The reply to a frame is itself a frame. */
static size_t msp_port_open(struct msp_port *port, uint8_t byte, uint8_t *reply, size_t capacity)
{
	if (!command_line_begin(&port->command_line, byte))
		return 0;
	msp_stream_stop(&port->peer.stream);
	if (byte != COMMAND_LINE_FRAME || capacity == 0)
		return 0;
	*reply = byte;
	return 1;
}

/* --- Bytes ------------------------------------------------------------------------------------------------------ */
static size_t msp_port_take(struct msp_port *port, const struct firmware_status *status, uint8_t byte, uint8_t *reply,
			    size_t capacity)
{
	const bool outside = msp_idle(&port->msp);

	if (command_line_open(&port->command_line))
		return msp_port_type(port, status, byte, reply, capacity);
	if (msp_push(&port->msp, byte))
		return msp_port_answer(port, status, reply, capacity);
	if (outside && msp_idle(&port->msp))
		return msp_port_open(port, byte, reply, capacity);
	return 0;
}

/* Says what the command line has to say, and takes what is held, as far as there is room. */
static size_t msp_port_converse(struct msp_port *port, const struct firmware_status *status, uint8_t *reply,
				size_t capacity)
{
	size_t written = 0;

	for (;;) {
		written += command_line_continue(&port->command_line, status, reply + written, capacity - written);
		if (port->held == 0 || command_line_busy(&port->command_line) || capacity - written < MSP_FRAME_MAX)
			return written;
		written += msp_port_take(port, status, msp_port_release(port), reply + written, capacity - written);
	}
}

/* Is it the letter alone? A UART's noise may look like it, so only a port whose line has none hears it. */
static bool msp_port_spells(struct msp_port *port, const struct firmware_status *status, const uint8_t *bytes,
			    size_t count)
{
	const uint32_t now = port->services->samples(port->services->context), before = port->heard_at;

	port->heard_at = now;
	return count == 1 && bytes[0] == NF_MSP_ROM_LETTER && !msp_port_converses(port) && msp_idle(&port->msp) &&
	       now - before >= status->gyro_rate_hz * NF_MSP_ROM_SILENCE_MS / 1000u;
}

bool msp_port_speaks(const struct msp_port *port, uint32_t step)
{
	return msp_port_converses(port) || msp_stream_due(&port->peer.stream, step);
}

size_t msp_port_serve(struct msp_port *port, const struct firmware_status *status, const uint8_t *bytes, size_t count,
		      uint8_t *reply, size_t capacity)
{
	size_t written = 0;

	if (count == 0 && !msp_port_converses(port) && msp_stream_due(&port->peer.stream, status->trace.step))
		return msp_port_speak(port, reply, capacity);
	if (port->letter && count > 0 && msp_port_spells(port, status, bytes, count)) {
		(void)port->services->reboot(port->services->context, NF_REBOOT_ROM); /* refused while armed */
		return 0;
	}
	for (size_t i = 0; i < count; ++i) {
		if (msp_port_converses(port)) {
			msp_port_hold(port, bytes[i]);
			written += msp_port_converse(port, status, reply + written, capacity - written);
		} else {
			written += msp_port_take(port, status, bytes[i], reply + written, capacity - written);
		}
	}
	return written + msp_port_converse(port, status, reply + written, capacity - written);
}
