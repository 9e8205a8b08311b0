/* Configuration messages of MSP that are lists, slots or texts: modes, ports, outputs, failsafe channels, names. */
#ifndef NF_MSP_LISTS_H
#define NF_MSP_LISTS_H

#include <stdbool.h>
#include <stdint.h>

#include "msp/msp_payload.h"
#include "msp/msp_view.h"

/* Names that the ecosystem's profiles have, and this firmware's do not. */
#define MSP_PID_PROFILE "standby" /* the PID stands by; the policy uses none of its numbers */
#define MSP_RATE_PROFILE ""

/* Answers a GET. Returns false if the command is none of these. *refusal: why it is refused. */
bool msp_lists_get(const struct msp_view *view, uint16_t command, struct msp_reader payload, struct msp_writer *reply,
		   enum nf_refusal *refusal);

/* Carries out a SET, as msp_fields_set does. Returns false if the command is none of these. */
bool msp_lists_set(const struct msp_view *view, uint16_t command, struct msp_reader payload, enum nf_refusal *refusal);

#endif
