#include "receiver/channels.h"

#define CHANNEL_BITS 11u
#define CHANNEL_MASK ((1u << CHANNEL_BITS) - 1u)
#define OCTET 8u /* channels, of whole bytes */
_Static_assert(CHANNELS_PACKED_BYTES * 8 == NF_CHANNEL_COUNT * CHANNEL_BITS, "no bit is left over");
_Static_assert(NF_CHANNEL_COUNT % OCTET == 0, "nor a channel");

/* Inlined with a constant `i` these are a few loads and shifts: a control step with a frame should take little longer. */
static inline __attribute__((always_inline)) uint16_t channels_one(const uint8_t *packed, unsigned i)
{
	const uint8_t *from = packed + i * CHANNEL_BITS / 8u;
	const unsigned shift = i * CHANNEL_BITS % 8u;
	uint32_t bits = from[0] | (uint32_t)from[1] << 8;

	if (shift + CHANNEL_BITS > 16u)
		bits |= (uint32_t)from[2] << 16;
	return (uint16_t)(880u + (5u * (bits >> shift & CHANNEL_MASK) + 4u) / 8u);
}

void channels_unpack(const uint8_t packed[CHANNELS_PACKED_BYTES], uint16_t channels_us[NF_CHANNEL_COUNT])
{
	for (unsigned i = 0; i < NF_CHANNEL_COUNT; i += OCTET) {
		channels_us[i] = channels_one(packed, 0);
		channels_us[i + 1u] = channels_one(packed, 1);
		channels_us[i + 2u] = channels_one(packed, 2);
		channels_us[i + 3u] = channels_one(packed, 3);
		channels_us[i + 4u] = channels_one(packed, 4);
		channels_us[i + 5u] = channels_one(packed, 5);
		channels_us[i + 6u] = channels_one(packed, 6);
		channels_us[i + 7u] = channels_one(packed, 7);
		packed += CHANNEL_BITS;
	}
}
