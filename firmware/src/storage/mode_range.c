#include "storage/mode_range.h"

#include "nf_contract.h"

#define AUX_SHIFT 8u
#define LOW_SHIFT 12u
#define HIGH_SHIFT 18u
#define AND_SHIFT 24u
#define STEP_MASK 0x3Fu

static const uint8_t modes[MODE_COUNT] = {
	[MODE_ARM] = NF_MODE_ARM, [MODE_BEEPER] = NF_MODE_BEEPER, [MODE_BLACKBOX] = NF_MODE_BLACKBOX,
	[MODE_PID] = NF_MODE_PID, [MODE_TRIAL] = NF_MODE_TRIAL,   [MODE_CHIRP] = NF_MODE_CHIRP,
};

enum mode_index mode_range_index(uint8_t mode)
{
	enum mode_index index = MODE_ARM;

	while (index < MODE_COUNT && modes[index] != mode)
		++index;
	return index;
}

uint8_t mode_range_mode(enum mode_index index)
{
	return modes[index];
}

struct mode_range mode_range_unpack(uint32_t packed)
{
	return (struct mode_range){
		.mode = (uint8_t)packed,
		.aux = (uint8_t)(packed >> AUX_SHIFT & 0xFu),
		.low = (uint8_t)(packed >> LOW_SHIFT & STEP_MASK),
		.high = (uint8_t)(packed >> HIGH_SHIFT & STEP_MASK),
		.and_others = packed >> AND_SHIFT != 0,
	};
}

uint32_t mode_range_pack(const struct mode_range *range)
{
	return range->mode | (uint32_t)range->aux << AUX_SHIFT | (uint32_t)range->low << LOW_SHIFT |
	       (uint32_t)range->high << HIGH_SHIFT | (uint32_t)range->and_others << AND_SHIFT;
}

bool mode_range_good(uint32_t packed)
{
	const struct mode_range range = mode_range_unpack(packed);

	return mode_range_index(range.mode) < MODE_COUNT && packed <= NF_MODE_RANGE_MAX && range.aux < NF_AUX_COUNT &&
	       range.low <= range.high && range.high <= NF_MODE_STEPS;
}
