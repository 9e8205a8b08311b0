/* Replies to the MSP commands that only read, and read no settings to be changed. Layouts: toolchain/contract/msp_messages.py. */
#ifndef NF_MSP_REPLIES_H
#define NF_MSP_REPLIES_H

#include <stdbool.h>
#include <stdint.h>

#include "common/status.h"
#include "msp/msp_payload.h"
#include "port/board_identity.h"
#include "storage/policy_slots.h"

/* Sources of the replies. */
struct msp_facts {
	const struct board_identity *identity;
	const struct firmware_status *status;
	const struct policy_slots *slots; /* NULL: there is no policy */
	const struct nf_settings *settings; /* NULL: names and variant are the defaults */
};

/* Writes the payload that answers `command`. Returns false if the command is none of these. */
bool msp_reply(uint16_t command, const struct msp_facts *facts, struct msp_writer *reply);

#endif
