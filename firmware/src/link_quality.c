#include "link_quality.h"

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

static void count(uint16_t *frames)
{
	if (*frames < SLOT_MAX)
		(*frames)++;
}

void link_quality_frame(struct link_quality *quality, bool good)
{
	count(&quality->all[quality->slot]);
	if (good)
		count(&quality->good[quality->slot]);
}

void link_quality_tell(struct link_quality *quality, uint8_t percent)
{
	quality->told = percent;
	quality->told_left = quality->slot_length * LINK_QUALITY_SLOTS;
}

static uint16_t sum(const uint16_t slots[LINK_QUALITY_SLOTS])
{
	uint16_t total = 0;

	for (int i = 0; i < LINK_QUALITY_SLOTS; i++)
		total = (uint16_t)(total + slots[i]);
	return total;
}

/* Only at the end of a slot: a second that ends within one would look like frames that stayed away. */
static void judge(struct link_quality *quality)
{
	const uint16_t all = sum(quality->all);

	if (all > quality->most)
		quality->most = all;
	if (quality->most > 0)
		quality->percent = (uint8_t)((100u * sum(quality->good) + quality->most / 2u) / quality->most);
}

void link_quality_tick(struct link_quality *quality)
{
	if (quality->told_left > 0)
		quality->told_left--;
	if (--quality->slot_left > 0)
		return;
	judge(quality);
	quality->slot_left = quality->slot_length;
	quality->slot = (uint8_t)((quality->slot + 1) % LINK_QUALITY_SLOTS);
	quality->good[quality->slot] = 0;
	quality->all[quality->slot] = 0;
}

unsigned link_quality_percent(const struct link_quality *quality)
{
	return quality->told_left > 0 ? quality->told : quality->percent;
}
