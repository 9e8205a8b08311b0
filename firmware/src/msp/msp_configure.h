/* Parts of the configuration messages of MSP, which msp_configure.c puts together. */
#pragma once

#include "msp/msp_request.h"

/* ---- msp_fields.c: messages by the contract's table (toolchain/contract/msp_configuration.py): what a field tells, and the
 * setting that it changes ---- */

/* Number of the message that `command`, a GET, or a SET, is of; -1: it is none of these. */
int msp_fields_find_get(uint16_t command);
int msp_fields_find_set(uint16_t command);

/* Returns whether a SET of that message requires that its peer has read the GET: all zeros are valid values there. */
bool msp_fields_read_first(int message);

/* Writes the payload of a GET. NF_REFUSAL_ABSENT: the settings do not fit the message's form, or the board has none. */
enum nf_refusal msp_fields_get(struct msp_request *q, int message);

/* Carries out a SET: each field that differs from what a GET would tell changes its setting. A payload may end after
 * any field that is not required, which leaves the settings of the missing fields alone, and may be longer than is
 * known. NF_REFUSAL_ABSENT: as the GET; nothing has changed. NF_REFUSAL_PAYLOAD: the length or the type of rates is
 * wrong; the SET must have no effect, but some of q->settings may have changed, so pass a copy. NF_REFUSAL_RANGE:
 * some fields are beyond their setting's limits or cannot be changed; they are left as they were, the others are
 * taken. */
enum nf_refusal msp_fields_set(struct msp_request *q, int message);

/* ---- msp_sources.c: fields that take more than a setting times a gain: enum nf_msp_source ---- */

/* Returns the value that a GET sends. */
uint32_t msp_source_get(const struct msp_request *q, enum nf_msp_source source, unsigned argument);

/* Applies a value from a SET that differs from the GET's. NF_REFUSAL_PAYLOAD: it cannot be changed. */
enum nf_refusal msp_source_set(const struct msp_request *q, enum nf_msp_source source, unsigned argument,
			       uint32_t value);

/* The same for scale, divider and multiplier of the battery's voltage, which make one setting together: what a scale
 * means depends on the divider behind it. NF_REFUSAL_RANGE: beyond the setting's limits. */
enum nf_refusal msp_source_set_voltage(const struct msp_request *q, const uint8_t parts[3]);

/* Do the settings fit the form that the ecosystem's filter messages have: low-passes in stages 1 and 2, notches in 3 and
 * 4? */
bool msp_filters_fit(const struct nf_settings *settings);

/* ---- msp_lists.c: messages that are lists, slots or texts: modes, ports, outputs, failsafe channels, names ---- */

/* Names that the ecosystem's profiles have, and this firmware's do not. */
#define MSP_PID_PROFILE "standby" /* the PID stands by; the policy uses none of its numbers */
#define MSP_RATE_PROFILE ""

/* Answers a GET, or carries out a SET as msp_fields_set does. Returns false if the command is none of these. */
bool msp_lists(struct msp_request *q, bool sets);
