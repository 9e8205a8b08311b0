/* MSP server, v1 and v2: bytes in, reply bytes out. Knows no port. */
#ifndef NF_MSP_H
#define NF_MSP_H

#include <stddef.h>
#include <stdint.h>

#include "common/status.h"
#include "msp/msp_identity.h"
#include "nf_contract.h"

struct msp_services;

/* The request being read. */
struct msp {
	const struct msp_identity *identity;
	const struct msp_services *services; /* NULL: only commands that read are served */
	uint8_t state;           /* enum msp_state of msp.c */
	uint8_t version;         /* 1 or 2 */
	uint8_t checksum;
	uint16_t command;
	uint16_t size;           /* of the payload */
	uint16_t received;       /* bytes of it */
	_Alignas(4) uint8_t payload[NF_MSP_PAYLOAD_MAX];
};

/* Serves commands that read. `identity` must outlive the server. */
void msp_init(struct msp *msp, const struct msp_identity *identity);

/* From now on serves those of msp_commands.h too. `services` must outlive the server. */
void msp_offer(struct msp *msp, const struct msp_services *services);

/* Forgets a half-read request: a new peer is on the line. */
void msp_reset(struct msp *msp);

/* Reads `count` bytes and answers each whole request found in them from `status`. Requests may be cut
 * anywhere. Returns the bytes written to `reply`; a reply that does not fit into `capacity` is dropped whole. */
size_t msp_serve(struct msp *msp, const struct firmware_status *status, const uint8_t *bytes, size_t count,
		 uint8_t *reply, size_t capacity);

#endif
