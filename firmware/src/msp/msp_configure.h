/* Configuration by MSP: the messages of msp_fields.h and msp_lists.h; of each what is good is taken. */
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
 * A SET changes only what the peer changed. What of it is refused leaves its setting as it was, and so do settings that would
 * not go together: the reply is the first refusal then, though the rest of it counts. Nothing of it counts while armed; where
 * its GET is refused; and, of a peer that has not read, where any of it is refused, or its zeros would mean something: who has
 * not read may send zeros for all that it does not know.
 * After a refusal the peer's next EEPROM_WRITE stores what counts, and is answered with NF_REFUSAL_SPOILT: it is not all. */
bool msp_configure(const struct msp_services *services, const struct firmware_status *status, struct msp_peer *peer,
		   uint16_t command, const uint8_t *payload, size_t size, struct msp_writer *reply,
		   enum nf_refusal *refusal);

#endif
