#include "receiver/link_quality.h"

/* So that the sum of all slots fits 16 bits. No receiver sends as many in a tenth of a second. */
#define SLOT_MAX (UINT16_MAX / LINK_QUALITY_SLOTS)

void link_quality_init(struct link_quality *quality, unsigned gyro_rate_hz)
{
	quality->slot_length = gyro_rate_hz / LINK_QUALITY_SLOTS;
	link_quality_reset(quality);
}

void link_quality_reset(struct link_quality *quality)
{
	const uint32_t length = quality->slot_length;

	*quality = (struct link_quality){ .slot_length = length, .slot_left = length };
}

static void link_quality_count(uint16_t *frames)
{
	if (*frames < SLOT_MAX)
		++*frames;
}

void link_quality_frame(struct link_quality *quality, bool good)
{
	link_quality_count(&quality->all[quality->slot]);
	if (good)
		link_quality_count(&quality->good[quality->slot]);
}

void link_quality_tell(struct link_quality *quality, uint8_t percent)
{
	quality->told = percent;
	quality->told_left = quality->slot_length * LINK_QUALITY_SLOTS;
}

/* Frames of the last second, including the slot that ends. The slot that is reused is then taken off the sum. */
static uint16_t link_quality_second_frames(uint16_t *sum, uint16_t slots[LINK_QUALITY_SLOTS], uint8_t ends,
					   uint8_t begins)
{
	const uint16_t whole = (uint16_t)(*sum + slots[ends]);

	*sum = (uint16_t)(whole - slots[begins]);
	slots[begins] = 0;
	return whole;
}

/* Only at the end of a slot: counting in the middle of one would show missing frames. */
static void link_quality_update(struct link_quality *quality)
{
	const uint8_t ends = quality->slot;
	const uint8_t begins = ends + 1 < LINK_QUALITY_SLOTS ? (uint8_t)(ends + 1) : 0;
	const uint16_t good = link_quality_second_frames(&quality->good_sum, quality->good, ends, begins);
	const uint16_t all = link_quality_second_frames(&quality->all_sum, quality->all, ends, begins);

	quality->slot = begins;
	if (all > quality->most)
		quality->most = all;
	if (quality->most > 0)
		quality->percent = (uint8_t)((100u * good + quality->most / 2u) / quality->most);
}

void link_quality_tick(struct link_quality *quality)
{
	if (quality->told_left > 0)
		--quality->told_left;
	if (--quality->slot_left > 0)
		return;
	quality->slot_left = quality->slot_length;
	link_quality_update(quality);
}

unsigned link_quality_percent(const struct link_quality *quality)
{
	return quality->told_left > 0 ? quality->told : quality->percent;
}
