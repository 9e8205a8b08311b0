/* Replies to the MSP commands that only read. Layouts are the ecosystem's at API 1.46, little-endian. */
#ifndef NF_MSP_REPLIES_H
#define NF_MSP_REPLIES_H

#include <stdbool.h>
#include <stdint.h>

#include "common/status.h"
#include "msp/msp_identity.h"
#include "msp/msp_payload.h"
#include "storage/policy_slots.h"

/* Writes the payload that answers `command`. `slots` NULL: the policy is the compiled-in one. Returns false if the
 * command is none of these. */
bool msp_reply(uint16_t command, const struct msp_identity *identity, const struct firmware_status *status,
	       const struct policy_slots *slots, struct msp_writer *reply);

#endif
