/* Configuration by MSP: the messages of msp_fields.h and msp_lists.h, each taken whole or not at all. */
#ifndef NF_MSP_CONFIGURE_H
#define NF_MSP_CONFIGURE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/status.h"
#include "msp/msp_commands.h"
#include "msp/msp_payload.h"
#include "msp/msp_peer.h"

/* Carries out `command` and writes the reply, as msp_command does. Returns false if it is none of these.
 *
 * A SET changes only what the peer changed, in a copy of the settings, which counts if all of it is taken and the
 * settings still go together. It is refused while armed; where its GET is; and, where zeros mean something, before
 * its peer has read. A refused one spoils what the peer changed before: its next EEPROM_WRITE is refused with
 * NF_REFUSAL_SPOILT and brings back the settings that are stored. */
bool msp_configure(const struct msp_services *services, const struct firmware_status *status, struct msp_peer *peer,
		   uint16_t command, const uint8_t *payload, size_t size, struct msp_writer *reply,
		   enum nf_refusal *refusal);

#endif
