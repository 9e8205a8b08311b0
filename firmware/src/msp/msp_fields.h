/* Configuration messages of MSP, by the contract's table (toolchain/contract/msp_configuration.py): what a field tells, and
 * the setting that it changes. */
#ifndef NF_MSP_FIELDS_H
#define NF_MSP_FIELDS_H

#include <stdbool.h>
#include <stdint.h>

#include "msp/msp_payload.h"
#include "msp/msp_view.h"

/* Number of the message that `command`, a GET, or a SET, is of; -1: it is none of these. */
int msp_fields_find_get(uint16_t command);
int msp_fields_find_set(uint16_t command);

/* Returns whether a SET of that message requires that its peer has read the GET: all zeros are valid values there. */
bool msp_fields_read_first(int message);

/* Writes the payload of a GET. NF_REFUSAL_ABSENT: the settings do not fit the message's form, or the board has none. */
enum nf_refusal msp_fields_get(const struct msp_view *view, int message, struct msp_writer *reply);

/* Carries out a SET: each field that differs from what a GET would tell changes its setting. A payload may end after
 * any field that is not required, which leaves the settings of the missing fields alone, and may be longer than is
 * known. NF_REFUSAL_ABSENT: as the GET; nothing has changed. NF_REFUSAL_PAYLOAD: the length or the type of rates is
 * wrong; the SET must have no effect, but some of view->settings may have changed, so pass a copy. NF_REFUSAL_RANGE:
 * some fields are beyond their setting's limits or cannot be changed; they are left as they were, the others are
 * taken. */
enum nf_refusal msp_fields_set(const struct msp_view *view, int message, struct msp_reader payload);

#endif
