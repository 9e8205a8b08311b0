"""The pilot's sticks, and the frames of the receivers that bring them."""

from __future__ import annotations

CHANNEL_COUNT = 16
CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_THROTTLE, CHANNEL_YAW, CHANNEL_AUX1 = range(5)
CHANNEL_MAPPED_COUNT = 8  # first channels of the receiver, ordered by the settings map_...
CHANNEL_MIN_US, CHANNEL_MID_US, CHANNEL_MAX_US = 1000, 1500, 2000
CHANNEL_VALID_MIN_US, CHANNEL_VALID_MAX_US = 750, 2250  # limits of valid pulses
CHANNEL_UNTOLD_US = 0  # of a channel that a frame over MSP does not contain
THROTTLE_LOW_US = 1050  # arming needs the throttle at or below this
STICK_LOW_US, STICK_HIGH_US = 1100, 1900  # beyond these a stick counts as at its end
GESTURE_MS = 2000  # throttle low, yaw left, pitch back, roll right for so long, disarmed: acknowledges
# Limit of commanded rates. The gyro saturates at 2000 deg/s, its bias may be 20, and the NF1 overshoots by up
# to 8 %: a rate beyond the gyro's range cannot be controlled. At 1800 deg/s of pitch with the throttle
# closed, the body's coupling of axes exceeds the rotors' authority.
RATE_MAX_DEG_S = 1600.0
RATE_FULL_STICK_DEG_S = 1000  # of scenarios' sticks: linear, no deadband, expo or interpolation
# The style betaflight: rate at full stick for an RC rate of 1; the part of an RC rate above RC_RATE_STEEP
# counts RC_RATE_STEEPER times more; least divisor that a super rate leaves at full stick.
RC_RATE_DEG_S, RC_RATE_STEEP, RC_RATE_STEEPER, SUPER_ROOM_MIN = 200.0, 2.0, 14.54, 0.01

# SBUS: 25 bytes, 16 channels of 11 bits. microseconds = 880 + (5 value + 4) / 8, in integers.
SBUS_FRAME_BYTES = 25
SBUS_HEADER, SBUS_FOOTER = 0x0F, 0x00
# S.BUS2 numbers its frames in bits 4 and 5 of the footer, and bit 2 announces slots for sensors:
# 0x04, 0x14, 0x24, 0x34 (R7008SB, a recording). An R7003SB sends 0x08 (one report). The bits of this mask
# are always 0.
SBUS_FOOTER_UNUSED = 0xC3
SBUS_FLAG_FRAME_LOST, SBUS_FLAG_FAILSAFE = 0x04, 0x08

# CRSF: sync, length of what follows, type, payload, CRC-8/DVB-S2 over type and payload; channels as in SBUS.
CRSF_SYNC = 0xC8
CRSF_FRAME_BYTES_MAX = 64
CRSF_TYPE_LINK, CRSF_TYPE_CHANNELS = 0x14, 0x16
