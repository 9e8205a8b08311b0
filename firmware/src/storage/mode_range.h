/* A range of an AUX channel that switches a mode on, as a setting holds it: ModeRange of toolchain/contract/modes.py. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

/* Modes side by side, in the contract's order: bits of firmware_status.modes. */
enum mode_index {
	MODE_ARM,
	MODE_BEEPER,
	MODE_BLACKBOX,
	MODE_PID,
	MODE_TRIAL,
	MODE_CHIRP,
	MODE_COUNT,
};
#define MODE_BIT(name) (1u << MODE_##name)

struct mode_range {
	uint8_t mode; /* enum nf_mode */
	uint8_t aux; /* 0 is AUX 1 */
	uint8_t low, high; /* steps of NF_MODE_STEP_US above NF_MODE_LOW_US; the same: there is no range */
	bool and_others; /* only while the other ranges of this kind hold as well */
};

/* Place of a mode (enum nf_mode), MODE_COUNT if it is none of ours. */
enum mode_index mode_range_index(uint8_t mode);

/* The mode (enum nf_mode) of a place below MODE_COUNT. */
uint8_t mode_range_mode(enum mode_index index);

struct mode_range mode_range_unpack(uint32_t packed);
uint32_t mode_range_pack(const struct mode_range *range);

/* Is it a mode of ours on a channel that there is, low not above high, and nothing else in it? */
bool mode_range_good(uint32_t packed);
