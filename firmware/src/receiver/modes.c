#include "receiver/modes.h"

#include <string.h>

_Static_assert(MODE_COUNT <= 8, "a bit each in struct modes_range");
_Static_assert(offsetof(struct nf_settings, mode20) - offsetof(struct nf_settings, mode1) ==
		       (NF_MODE_SLOT_COUNT - 1) * sizeof(uint32_t),
	       "side by side");

static uint32_t modes_init_us(uint32_t step)
{
	return step * NF_MODE_STEP_US + NF_MODE_LOW_US;
}

static void modes_init_range(struct modes_range *out, const struct mode_range *range)
{
	/* A channel beyond the limits counts as the nearest value inside: a range that ends there has no end. */
	const uint32_t low_us = range->low > 0 ? modes_init_us(range->low) : NF_CHANNEL_UNTOLD_US + 1u;
	const uint32_t high_us = range->high < NF_MODE_STEPS ? modes_init_us(range->high) : UINT16_MAX + 1u;
	const uint8_t bit = (uint8_t)(1u << mode_range_index(range->mode));

	*out = (struct modes_range){
		.low_us = (uint16_t)low_us,
		.span_us = (uint16_t)(high_us - 1u - low_us),
		.channel = (uint8_t)(NF_CHANNEL_AUX1 + range->aux),
		.alone = range->and_others ? 0 : bit,
		.together = range->and_others ? bit : 0,
	};
}

void modes_init(struct modes *modes, const struct nf_settings *settings)
{
	uint32_t slots[NF_MODE_SLOT_COUNT];

	memcpy(slots, (const uint8_t *)settings + offsetof(struct nf_settings, mode1), sizeof slots);
	*modes = (struct modes){ 0 };
	for (unsigned i = 0; i < NF_MODE_SLOT_COUNT; ++i) {
		const struct mode_range range = mode_range_unpack(slots[i]);
		struct modes_range *out = &modes->ranges[modes->count];
		if (range.low == range.high)
			continue;
		modes_init_range(out, &range);
		modes->joined |= out->together;
		++modes->count;
	}
}

uint32_t modes_on(const struct modes *modes, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	const struct modes_range *range = modes->ranges, *const end = range + modes->count;
	uint32_t on = 0, missing = 0;

	/* What lies below low_us wraps to more than any span. */
	for (; range < end; ++range)
		if ((uint16_t)(channels_us[range->channel] - range->low_us) <= range->span_us)
			on |= range->alone;
		else
			missing |= range->together;
	return on | (modes->joined & ~missing);
}
