/* What each MSP command is answered with. Layouts are the ecosystem's at API 1.46, little-endian. */
#ifndef NF_MSP_REPLIES_H
#define NF_MSP_REPLIES_H

#include <stdint.h>

#include "msp.h"

#define MSP_REPLY_MAX 160

/* Writes the payload that answers `command`. Returns its length, or -1 for a command that is unknown. */
int msp_reply(uint16_t command, const struct msp_identity *identity, const struct firmware_status *status,
	      uint8_t payload[MSP_REPLY_MAX]);

#endif
