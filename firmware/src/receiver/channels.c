#include "receiver/channels.h"

#define CHANNEL_BITS 11u
#define CHANNEL_MASK ((1u << CHANNEL_BITS) - 1u)
_Static_assert(CHANNELS_PACKED_BYTES * 8 == NF_CHANNEL_COUNT * CHANNEL_BITS, "no bit is left over");

void channels_unpack(const uint8_t packed[CHANNELS_PACKED_BYTES], uint16_t channels_us[NF_CHANNEL_COUNT])
{
	for (unsigned i = 0; i < NF_CHANNEL_COUNT; ++i) {
		const uint8_t *from = packed + i * CHANNEL_BITS / 8;
		const unsigned shift = i * CHANNEL_BITS % 8;
		uint32_t bits = from[0] | (uint32_t)from[1] << 8;
		if (shift + CHANNEL_BITS > 16)
			bits |= (uint32_t)from[2] << 16;
		const uint32_t value = bits >> shift & CHANNEL_MASK;
		channels_us[i] = (uint16_t)(880u + (5u * value + 4u) / 8u);
	}
}
