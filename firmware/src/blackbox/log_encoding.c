#include "blackbox/log_encoding.h"

#include <stdbool.h>

static void log_put(uint8_t **at, uint32_t byte)
{
	*(*at)++ = (uint8_t)byte;
}

void log_put_unsigned(uint8_t **at, uint32_t value)
{
	uint8_t *byte = *at;

	for (; value > 127u; value >>= 7)
		*byte++ = (uint8_t)(value | 128u);
	*byte++ = (uint8_t)value;
	*at = byte;
}

void log_put_signed(uint8_t **at, int32_t value)
{
	log_put_unsigned(at, (uint32_t)value << 1 ^ (value < 0 ? UINT32_MAX : 0u));
}

void log_put_tag8_8svb(uint8_t **at, const int32_t values[], unsigned count)
{
	uint32_t told = 0;

	if (count == 1) {
		log_put_signed(at, values[0]);
		return;
	}
	for (unsigned i = 0; i < count; ++i)
		told |= (uint32_t)(values[i] != 0) << i;
	log_put(at, told);
	for (unsigned i = 0; i < count; ++i)
		if (values[i] != 0)
			log_put_signed(at, values[i]);
}

/* Does it fit into so many bits, one of them its sign? */
static bool log_fits(int32_t value, unsigned bits)
{
	const int32_t end = (int32_t)(1u << (bits - 1u));

	return value >= -end && value < end;
}

void log_put_tag2_3s32(uint8_t **at, const int32_t values[3])
{
	unsigned bits = 2, tags = 0;

	for (unsigned i = 0; i < 3; ++i)
		while (bits < 8 && !log_fits(values[i], bits))
			bits += 2;
	const uint32_t v[3] = { (uint32_t)values[0], (uint32_t)values[1], (uint32_t)values[2] };
	switch (bits) {
	case 2:
		log_put(at, (v[0] & 3u) << 4 | (v[1] & 3u) << 2 | (v[2] & 3u));
		return;
	case 4:
		log_put(at, 1u << 6 | (v[0] & 15u));
		log_put(at, v[1] << 4 | (v[2] & 15u));
		return;
	case 6:
		log_put(at, 2u << 6 | (v[0] & 63u));
		log_put(at, v[1] & 63u);
		log_put(at, v[2] & 63u);
		return;
	default:
		break;
	}
	uint8_t *const head = (*at)++;
	for (unsigned i = 0; i < 3; ++i) {
		unsigned bytes = 1;
		while (bytes < 3 && !log_fits(values[i], 8 * bytes))
			++bytes;
		tags |= (bytes - 1u) << 2 * i;
		for (unsigned k = 0; k < bytes; ++k)
			log_put(at, v[i] >> 8 * k);
	}
	*head = (uint8_t)(3u << 6 | tags);
}
