/* Converts the simulator's values to those of a board's sensors. Pure functions. */
#pragma once

#include "nf_contract.h"
#include "port/hal.h"
#include "port/imu.h"
#include "receiver/channels.h"

/* Body rates [rad/s], axes forward, right, down, to the counts of a chip with this alignment, +-2000 deg/s over int16,
 * rounded half to even and saturated. Returns false, `counts` left alone, if a rate is NaN, which has no count. */
bool convert_rates(const double rates_frd[3], enum board_alignment alignment, int16_t counts[3]);

/* Specific force [m/s^2], axes forward, right, down, to the counts of that chip's accelerometer, +-16 g over int16,
 * rounded and saturated alike. A force that is NaN counts as none. */
void convert_force(const double force_frd[3], enum board_alignment alignment, int16_t counts[3]);

/* Voltages at the pins of divider and current sensor for a pack's volts and amperes, at the default scales of the
 * settings. Not valid if one is NaN or negative. */
struct power_sample convert_power(double volts, double amps);

#define CONVERT_FRAME_BYTES_MAX (CHANNELS_PACKED_BYTES + 4u) /* CRSF: sync, length, type; CRC */
_Static_assert(NF_SBUS_FRAME_BYTES <= CONVERT_FRAME_BYTES_MAX, "SBUS is shorter");

/* Writes one frame of the receiver protocol NF_RECEIVER_PROTOCOL_...; returns its length in bytes, 0 for a protocol
 * that does not use the receiver's line. Channels [us] outside 880..2159 are sent as the nearer limit; each whole
 * microsecond in between is decoded to the same value. */
size_t convert_frame(uint32_t protocol, const uint16_t channels_us[NF_CHANNEL_COUNT],
		     uint8_t frame[CONVERT_FRAME_BYTES_MAX]);

/* The motor fraction of a DShot value, as an ESC decodes it: 0 for 0, else (value - 48) / 1999. */
float convert_dshot(uint16_t value);
