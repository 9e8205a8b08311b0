/* A port: the line of one MSP peer, and what belongs to that peer. Bytes in, reply bytes out; knows no device. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "command_line/command_line.h"
#include "common/status.h"
#include "msp/msp.h"
#include "msp/msp_request.h"

/* Bytes that wait while a session of the command line speaks. */
#define MSP_PORT_HOLDS 128u

struct msp_port {
	const struct services *services;
	bool letter;       /* NF_MSP_ROM_LETTER is heard */
	uint8_t hidden;    /* bytes of what may be a request, at the start of a line */
	uint8_t held_from, held; /* bytes that wait for the command line: the first's place, and how many */
	uint32_t heard_at; /* gyro sample at which bytes came last */
	struct msp_peer peer;
	struct command_line command_line;
	uint8_t holds[MSP_PORT_HOLDS];
	struct msp msp;    /* the request being read */
};

/* `services` must outlive the port. */
void msp_port_init(struct msp_port *port, const struct services *services);

/* The peer has gone, or a new one is there: nothing of the last one's is left. */
void msp_port_reset(struct msp_port *port);

/* The peer has paused: a request half read is void, what follows begins anew. */
void msp_port_pause(struct msp_port *port);

/* Bytes from the peer were lost: a request half read is void. */
void msp_port_lost(struct msp_port *port);

/* Returns whether msp_port_serve has unsolicited output after control step `step`. */
bool msp_port_speaks(const struct msp_port *port, uint32_t step);

/* Is there more to say, or to carry out, before more bytes are read? They wait with the peer or in the line meanwhile;
 * at most MSP_PORT_HOLDS may come all the same. */
bool msp_port_busy(const struct msp_port *port);

/* Reads `count` bytes and answers each whole request found in them from `status`. Requests may be cut anywhere. Returns
 * the bytes written to `reply`; a reply that does not fit into `capacity` is dropped whole. Where MSP_FRAME_MAX bytes
 * fit and `count` is MSP_REQUEST_MIN at most, none is dropped. With `count` 0 it says what is due unasked.
 *
 * Outside of requests, bytes may open the command line; a whole request ends its session. */
size_t msp_port_serve(struct msp_port *port, const struct firmware_status *status, const uint8_t *bytes, size_t count,
		      uint8_t *reply, size_t capacity);
