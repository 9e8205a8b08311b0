#include "msp/msp_port.h"

#include "msp/msp_commands.h"
#include "msp/msp_configure.h"
#include "msp/msp_replies.h"

void msp_port_init(struct msp_port *port, const struct msp_identity *identity, const struct msp_services *services)
{
	*port = (struct msp_port){ .identity = identity, .services = services };
	msp_reset(&port->msp);
}

void msp_port_reset(struct msp_port *port)
{
	const struct msp_services *services = port->services;

	msp_reset(&port->msp);
	if (services && services->arming)
		(void)services->arming(services->context, &port->peer, false, false);
	port->peer = (struct msp_peer){ 0 };
}

void msp_port_pause(struct msp_port *port)
{
	msp_reset(&port->msp);
}

void msp_port_lost(struct msp_port *port)
{
	msp_reset(&port->msp);
}

/* Carries out the request just read. Returns whether it is refused, for being unknown or otherwise. */
static bool msp_port_carry_out(struct msp_port *port, const struct firmware_status *status, struct msp_writer *payload)
{
	const struct msp_services *services = port->services;
	const struct msp *msp = &port->msp;
	const struct msp_facts facts = {
		.identity = port->identity,
		.status = status,
		.slots = services ? services->slots : NULL,
		.settings = services ? services->settings : NULL,
	};
	enum nf_refusal refusal;

	if (services && services->heard)
		services->heard(services->context, &port->peer);
	if (msp_reply(msp->command, &facts, payload))
		return false;
	if (!services)
		return true;
	return !(msp_configure(services, status, &port->peer, msp->command, msp->payload, msp->size, payload,
			       &refusal) ||
		 msp_command(services, &port->peer, status, msp->command, msp->payload, msp->size, payload,
			     &refusal)) ||
	       refusal != NF_REFUSAL_NONE;
}

/* Writes the reply to the request just read; 0 bytes if it does not fit. */
static size_t msp_port_answer(struct msp_port *port, const struct firmware_status *status, uint8_t *reply,
			      size_t capacity)
{
	const struct msp *msp = &port->msp;
	uint8_t payload[MSP_REPLY_MAX];
	struct msp_writer writer = { payload, payload + sizeof payload };
	const bool refused = msp_port_carry_out(port, status, &writer);

	return msp_frame(msp->version, msp->command, refused, payload, (size_t)(writer.at - payload), reply, capacity);
}

bool msp_port_speaks(const struct msp_port *port, uint32_t step)
{
	return msp_stream_due(&port->peer.stream, step);
}

/* Says what is due unasked. */
static size_t msp_port_speak(struct msp_port *port, uint8_t *words, size_t capacity)
{
	struct control_record record;

	port->services->record(port->services->context, &record);
	return msp_stream_due(&port->peer.stream, record.trace.step) ?
		       msp_stream_write(&port->peer.stream, &record, words, capacity) :
		       0;
}

size_t msp_port_serve(struct msp_port *port, const struct firmware_status *status, const uint8_t *bytes, size_t count,
		      uint8_t *reply, size_t capacity)
{
	size_t written = 0;

	if (count == 0 && msp_port_speaks(port, status->trace.step))
		return msp_port_speak(port, reply, capacity);
	for (size_t i = 0; i < count; ++i)
		if (msp_push(&port->msp, bytes[i]))
			written += msp_port_answer(port, status, reply + written, capacity - written);
	return written;
}
