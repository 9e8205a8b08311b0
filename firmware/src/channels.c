#include "channels.h"

#define CHANNEL_BITS 11u
_Static_assert(NF_CHANNEL_COUNT * CHANNEL_BITS == CHANNELS_PACKED_BYTES * 8, "no bit is left over");

void channels_unpack(const uint8_t packed[CHANNELS_PACKED_BYTES], uint16_t channels_us[NF_CHANNEL_COUNT])
{
	const uint8_t *next = packed;
	uint32_t bits = 0;
	unsigned held = 0;

	for (int i = 0; i < NF_CHANNEL_COUNT; i++) {
		for (; held < CHANNEL_BITS; held += 8)
			bits |= (uint32_t)*next++ << held;
		const uint32_t value = bits & ((1u << CHANNEL_BITS) - 1);
		channels_us[i] = (uint16_t)(880u + (5u * value + 4u) / 8u);
		bits >>= CHANNEL_BITS;
		held -= CHANNEL_BITS;
	}
}
