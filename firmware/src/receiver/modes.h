/* Modes: which of them the AUX channels switch on, by the ranges that the settings mode1, mode2, ... have. */
#pragma once

#include "nf_contract.h"
#include "storage/mode_range.h"

/* The ranges in use, ready to be compared with channels. */
struct modes {
	struct modes_range {
		uint16_t low_us, span_us; /* it holds from low_us to low_us + span_us */
		uint8_t channel;
		uint8_t alone;    /* bit of its mode, or 0: */
		uint8_t together; /* it switches its mode on only together with others; one of the two is 0 */
	} ranges[NF_MODE_SLOT_COUNT];
	uint8_t count;
	uint8_t joined; /* modes that have ranges of the second kind */
};

/* `settings` within their limits; what is needed of them is copied. */
void modes_init(struct modes *modes, const struct nf_settings *settings);

/* Bit field of enum mode_index: the modes that these channels [us], mapped, switch on. A mode is on if one of its plain
 * ranges holds, or if it has ranges of the kind "and" and all of these hold. Channels below NF_MODE_LOW_US are in ranges
 * that begin there, those above the last end in ranges that end there; one of NF_CHANNEL_UNTOLD_US is in none. */
uint32_t modes_on(const struct modes *modes, const uint16_t channels_us[NF_CHANNEL_COUNT]);
