/* Fields of configuration messages that take more than a setting times a gain: enum nf_msp_source. */
#ifndef NF_MSP_SOURCES_H
#define NF_MSP_SOURCES_H

#include <stdbool.h>
#include <stdint.h>

#include "msp/msp_view.h"

/* Returns the value that a GET sends. */
uint32_t msp_source_get(const struct msp_view *view, enum nf_msp_source source, unsigned argument);

/* Applies a value from a SET that differs from the GET's. NF_REFUSAL_PAYLOAD: it cannot be changed. */
enum nf_refusal msp_source_set(const struct msp_view *view, enum nf_msp_source source, unsigned argument,
			       uint32_t value);

/* The same for scale, divider and multiplier of the battery's voltage, which make one setting together: what a scale
 * means depends on the divider behind it. NF_REFUSAL_RANGE: beyond the setting's limits. */
enum nf_refusal msp_source_set_voltage(const struct msp_view *view, const uint8_t parts[3]);

/* Do the settings fit the form that the ecosystem's filter messages have: low-passes in stages 1 and 2, notches in 3 and
 * 4? */
bool msp_filters_fit(const struct nf_settings *settings);

#endif
