/* MSP's frames, v1 and v2: bytes to requests, replies to bytes. */
#pragma once

#include "nf_contract.h"

#define MSP_REQUEST_MIN 6u /* bytes of the shortest request: at most one ends within as many bytes */
#define MSP_REPLY_MAX 240u /* bytes of a reply's payload */
#define MSP_FRAME_MAX (MSP_REPLY_MAX + 9u) /* of a reply */

/* The request being read. */
struct msp {
	_Alignas(4) uint8_t payload[NF_MSP_PAYLOAD_MAX]; /* first, and so at the same place for who knows no _Alignas */
	uint8_t state; /* enum msp_state of msp.c */
	uint8_t version; /* 1 or 2 */
	uint8_t checksum;
	uint16_t command;
	uint16_t size; /* of the payload */
	uint16_t received; /* bytes of it */
};

/* Forgets a half-read request. Zeros are such a state too. */
void msp_reset(struct msp *msp);

/* Is no request half read? */
bool msp_idle(const struct msp *msp);

/* Takes one byte. Returns whether it completed a request, which is then in version, command, size and payload. */
bool msp_push(struct msp *msp, uint8_t byte);

/* Writes a reply with a payload of `size` bytes, at most MSP_REPLY_MAX, as a frame of that version. Returns its bytes;
 * 0, and nothing is written, if it does not fit into `capacity`. */
size_t msp_frame(unsigned version, uint16_t command, bool refused, const uint8_t *payload, size_t size, uint8_t *frame,
		 size_t capacity);
