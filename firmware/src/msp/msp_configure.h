/* MSP configuration: the messages of msp_fields.h and msp_lists.h. The valid fields of a SET are taken, the others
 * refused. */
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
 * A SET changes the settings whose fields differ from what its GET tells. A refused field leaves its setting as it was,
 * and so do settings that would conflict; the other fields are taken, and the reply is an error that names a refusal.
 * Nothing is taken while armed, or where the GET is refused. A peer that has not sent the GET may send zeros for fields
 * that it does not know: from it a SET is taken whole or not at all, and not at all where zeros are valid values. After
 * a refusal the peer's next EEPROM_WRITE stores what was taken, and is answered with NF_REFUSAL_SPOILT: stored, but not
 * all. */
bool msp_configure(const struct msp_services *services, const struct firmware_status *status, struct msp_peer *peer,
		   uint16_t command, const uint8_t *payload, size_t size, struct msp_writer *reply,
		   enum nf_refusal *refusal);

#endif
