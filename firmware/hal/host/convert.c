#include "hal/host/convert.h"

#include <math.h>

#define DEG_PER_RAD (180.0 / 3.14159265358979323846)
#define SBUS_ZERO_US 880u
#define SBUS_VALUE_MAX 2047u

/* Chip axis i is body axis (x forward, y left, z up) `axis[i]` times `sign[i]`: the chip is turned clockwise
 * seen from above. Written from the chip's side; the core holds the inverse. */
static const struct mounting {
	uint8_t axis[3];
	double sign[3];
} mountings[ALIGN_COUNT] = {
	[ALIGN_CW0] = { { 0, 1, 2 }, { 1.0, 1.0, 1.0 } },
	[ALIGN_CW90] = { { 1, 0, 2 }, { -1.0, 1.0, 1.0 } },
	[ALIGN_CW180] = { { 0, 1, 2 }, { -1.0, -1.0, 1.0 } },
	[ALIGN_CW270] = { { 1, 0, 2 }, { 1.0, -1.0, 1.0 } },
};

static int16_t quantise(double rate)
{
	const double deg_s = rate * DEG_PER_RAD;
	const double counts = rint(deg_s * NF_GYRO_COUNTS / NF_GYRO_FULL_SCALE_DEG_S);

	if (counts >= INT16_MAX)
		return INT16_MAX;
	if (counts <= INT16_MIN)
		return INT16_MIN;
	return (int16_t)counts;
}

bool convert_rates(const double rates_frd[3], enum board_alignment alignment, int16_t counts[3])
{
	const double body[3] = { rates_frd[0], -rates_frd[1], -rates_frd[2] };
	const struct mounting *m = &mountings[alignment];

	if (isnan(body[0]) || isnan(body[1]) || isnan(body[2]))
		return false;
	for (int i = 0; i < 3; i++)
		counts[i] = quantise(m->sign[i] * body[m->axis[i]]);
	return true;
}

/* The SBUS value that reads back as `us`: the inverse of 880 + (5 value + 4) / 8. */
static uint32_t sbus_value(uint16_t us)
{
	if (us <= SBUS_ZERO_US)
		return 0;
	const uint32_t value = (us - SBUS_ZERO_US) * 8u / 5u;
	return value < SBUS_VALUE_MAX ? value : SBUS_VALUE_MAX;
}

void convert_channels(const uint16_t channels_us[NF_CHANNEL_COUNT], uint8_t frame[NF_SBUS_FRAME_BYTES])
{
	uint8_t *next = frame;
	uint32_t bits = 0;
	unsigned held = 0;

	*next++ = NF_SBUS_HEADER;
	for (int i = 0; i < NF_CHANNEL_COUNT; i++) {
		bits |= sbus_value(channels_us[i]) << held;
		for (held += 11; held >= 8; held -= 8) {
			*next++ = (uint8_t)bits;
			bits >>= 8;
		}
	}
	*next++ = 0; /* flags */
	*next = NF_SBUS_FOOTER;
}

float convert_dshot(uint16_t value)
{
	if (value < NF_DSHOT_MIN)
		return 0.0f;
	return (float)(value - NF_DSHOT_MIN) / (float)NF_DSHOT_SPAN;
}
