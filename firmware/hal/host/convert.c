#include "hal/host/convert.h"

#include <math.h>

#include "common/crc8.h"
#include "nf_contract.h"

#define DEG_PER_RAD (180.0 / 3.14159265358979323846)
#define STANDARD_GRAVITY 9.80665 /* m/s^2 */
#define ACCEL_COUNTS_PER_G 2048.0 /* 16 g over 32768 counts */
#define CHANNEL_ZERO_US 880u
#define CHANNEL_VALUE_MAX 2047u

/* Chip axis i is body axis (x forward, y left, z up) `axis[i]` times `sign[i]`: the chip is turned clockwise
 * seen from above, and flipped before that. Written from the chip's side; the core holds the inverse. */
static const struct mounting {
	uint8_t axis[3];
	double sign[3];
} mountings[ALIGN_COUNT] = {
	[ALIGN_CW0] = { { 0, 1, 2 }, { 1.0, 1.0, 1.0 } },
	[ALIGN_CW90] = { { 1, 0, 2 }, { -1.0, 1.0, 1.0 } },
	[ALIGN_CW180] = { { 0, 1, 2 }, { -1.0, -1.0, 1.0 } },
	[ALIGN_CW270] = { { 1, 0, 2 }, { 1.0, -1.0, 1.0 } },
	[ALIGN_CW0_FLIP] = { { 0, 1, 2 }, { -1.0, 1.0, -1.0 } },
	[ALIGN_CW90_FLIP] = { { 1, 0, 2 }, { 1.0, 1.0, -1.0 } },
	[ALIGN_CW180_FLIP] = { { 0, 1, 2 }, { 1.0, -1.0, -1.0 } },
	[ALIGN_CW270_FLIP] = { { 1, 0, 2 }, { -1.0, -1.0, -1.0 } },
};

static int16_t convert_rounded(double counts)
{
	const double whole = rint(counts);

	if (whole >= INT16_MAX)
		return INT16_MAX;
	if (whole <= INT16_MIN)
		return INT16_MIN;
	return (int16_t)whole;
}

/* A vector in the simulator's axes as the chip so aligned sees it, times `scale`. */
static void convert_mount(const double frd[3], enum board_alignment alignment, double scale, int16_t counts[3])
{
	const double body[3] = { frd[0], -frd[1], -frd[2] };
	const struct mounting *m = &mountings[alignment];

	for (int i = 0; i < 3; ++i)
		counts[i] = convert_rounded(m->sign[i] * body[m->axis[i]] * scale);
}

static bool convert_any_nan(const double values[3])
{
	return isnan(values[0]) || isnan(values[1]) || isnan(values[2]);
}

bool convert_rates(const double rates_frd[3], enum board_alignment alignment, int16_t counts[3])
{
	double deg_s[3];

	if (convert_any_nan(rates_frd))
		return false;
	for (int i = 0; i < 3; ++i)
		deg_s[i] = rates_frd[i] * DEG_PER_RAD * NF_GYRO_COUNTS / NF_GYRO_FULL_SCALE_DEG_S;
	convert_mount(deg_s, alignment, 1.0, counts);
	return true;
}

void convert_force(const double force_frd[3], enum board_alignment alignment, int16_t counts[3])
{
	static const double none[3];

	convert_mount(convert_any_nan(force_frd) ? none : force_frd, alignment, ACCEL_COUNTS_PER_G / STANDARD_GRAVITY,
		      counts);
}

static uint16_t convert_millivolts(double volts)
{
	const double whole = rint(volts * 1000.0);

	return whole < UINT16_MAX ? (uint16_t)whole : UINT16_MAX;
}

struct power_sample convert_power(double volts, double amps)
{
	if (!(volts >= 0.0 && amps >= 0.0))
		return (struct power_sample){ .valid = false };
	return (struct power_sample){
		.volts_mv = convert_millivolts(volts / (double)NF_SIM_VOLTS_SCALE),
		.amps_mv = convert_millivolts(amps * (double)NF_SIM_AMPS_SCALE / 1000.0),
		.valid = true,
	};
}

/* Returns the 11-bit value that a receiver frame carries for `us`: the inverse of 880 + (5 value + 4) / 8. */
static uint32_t convert_channel(uint16_t us)
{
	if (us <= CHANNEL_ZERO_US)
		return 0;
	const uint32_t value = (us - CHANNEL_ZERO_US) * 8u / 5u;
	return value < CHANNEL_VALUE_MAX ? value : CHANNEL_VALUE_MAX;
}

/* Packs 16 values of 11 bits, the first in the lowest bits, as SBUS and CRSF both do. */
static void convert_channels(const uint16_t channels_us[NF_CHANNEL_COUNT], uint8_t packed[CHANNELS_PACKED_BYTES])
{
	uint32_t bits = 0;
	unsigned held = 0;

	for (int i = 0; i < NF_CHANNEL_COUNT; ++i) {
		bits |= convert_channel(channels_us[i]) << held;
		for (held += 11; held >= 8; held -= 8) {
			*packed++ = (uint8_t)bits;
			bits >>= 8;
		}
	}
}

static size_t convert_sbus(const uint16_t channels_us[NF_CHANNEL_COUNT], uint8_t *frame)
{
	frame[0] = NF_SBUS_HEADER;
	convert_channels(channels_us, frame + 1);
	frame[NF_SBUS_FRAME_BYTES - 2] = 0; /* flags */
	frame[NF_SBUS_FRAME_BYTES - 1] = NF_SBUS_FOOTER;
	return NF_SBUS_FRAME_BYTES;
}

static size_t convert_crsf(const uint16_t channels_us[NF_CHANNEL_COUNT], uint8_t *frame)
{
	frame[0] = NF_CRSF_SYNC;
	frame[1] = 1 + CHANNELS_PACKED_BYTES + 1; /* type, channels, CRC */
	frame[2] = NF_CRSF_TYPE_CHANNELS;
	convert_channels(channels_us, frame + 3);
	frame[CONVERT_FRAME_BYTES_MAX - 1] = crc8(0, frame + 2, 1 + CHANNELS_PACKED_BYTES);
	return CONVERT_FRAME_BYTES_MAX;
}

size_t convert_frame(uint32_t protocol, const uint16_t channels_us[NF_CHANNEL_COUNT],
		     uint8_t frame[CONVERT_FRAME_BYTES_MAX])
{
	switch (protocol) {
	case NF_RECEIVER_PROTOCOL_SBUS:
		return convert_sbus(channels_us, frame);
	case NF_RECEIVER_PROTOCOL_CRSF:
		return convert_crsf(channels_us, frame);
	default:
		return 0;
	}
}

float convert_dshot(uint16_t value)
{
	if (value < NF_DSHOT_MIN)
		return 0.0f;
	return (float)(value - NF_DSHOT_MIN) / (float)NF_DSHOT_SPAN;
}
