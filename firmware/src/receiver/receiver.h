/* Receiver: bytes of any protocol to the channels that are flown, how old they are in gyro samples, and what is
 * flown when they stay away.
 *
 * No single frame ends a flight. A frame may be wrong and yet pass: SBUS has parity bits only, which miss two flipped
 * bits of one byte; CRSF's CRC-8 misses two bits that lie 93 apart (the order of x modulo its polynomial), for which its
 * frames of 192 bits have room; MSP's sum is weaker still. So on each protocol NF_RECEIVER_OFF_FRAMES good frames in
 * a row must say that the mode ARM is off. That costs the time of one frame: 4 ms of CRSF at 250 Hz, 7 to 14 ms of
 * SBUS. "On" counts at once, but only after an "off" that counted: on, off, on never arms.
 *
 * A receiver that has lost its transmitter may send on, channels that it repeats or has been taught. What they say counts
 * for nothing, "off" neither: a frame that is flagged is no frame. One that says failsafe holds at once, as if the silence
 * had lasted so long; lost is what has had no good frame for the setting failsafe_delay_ms, flagged frames or none. */
#pragma once

#include "nf_contract.h"
#include "receiver/crsf.h"
#include "receiver/link_quality.h"
#include "receiver/modes.h"
#include "receiver/sbus.h"

enum receiver_link {
	RECEIVER_LOST, /* never heard, or no good frame for the setting failsafe_delay_ms, and until good ones have come
			* for NF_RECEIVER_RECOVERY_MS again */
	RECEIVER_HOLD, /* none for the setting failsafe_hold_ms, or flagged: rates centred, throttle kept */
	RECEIVER_GOOD,
};

#define RECEIVER_STICKS 3 /* that turn the aircraft: roll, pitch, yaw */

struct receiver {
	union {
		struct sbus sbus;
		struct crsf crsf;
	} line; /* the frame being read, by protocol */
	uint8_t protocol; /* NF_RECEIVER_PROTOCOL_... */
	uint8_t map[NF_CHANNEL_MAPPED_COUNT]; /* which of the wire's channels is this one */
	struct modes modes;
	bool interpolates;
	uint16_t channels_us[NF_CHANNEL_COUNT]; /* of the last good frame, mapped */
	uint32_t on; /* modes that it switches on (enum mode_index), ARM as it counts */
	uint16_t from_us[RECEIVER_STICKS]; /* sticks as they were flown when it came */
	uint32_t interval; /* gyro samples between two frames, 0: not known */
	uint32_t since; /* gyro samples since the last frame, at most pause_after */
	uint32_t age; /* gyro samples since the last good frame, at most lost_after */
	uint32_t recovering; /* gyro samples until a frame may make the link good again; 1: the
						 * next one does; 0: the link is not lost */
	uint8_t offs; /* frames in a row that say off while ARM counts as on */
	uint32_t flagged; /* gyro samples for which it counts that the receiver said it has lost its
						 * transmitter; 0: it has not */
	uint32_t silent; /* gyro samples since the last byte, at most gap_after */
	uint32_t hold_after, lost_after, recovery, pause_after, flag_length, gap_after; /* gyro samples */
	struct link_quality quality;
};

/* Starts lost. `settings` within their limits; what is needed of them is copied. */
void receiver_init(struct receiver *receiver, const struct nf_settings *settings, unsigned gyro_rate_hz);

/* Reads bytes up to the end of the next frame, and moves *bytes and *count past what it read. Returns whether a frame
 * came; false: all bytes are read. The caller evaluates the channels after each frame, so that no "off" is lost behind
 * an "on":
 *
 *	while (receiver_push(&receiver, &bytes, &count))
 *		look();
 *
 * Survives any bytes. Ignores them if the protocol is MSP. */
bool receiver_push(struct receiver *receiver, const uint8_t **bytes, size_t *count);

/* May the bytes that receiver_push has taken hold another frame? */
bool receiver_waits(const struct receiver *receiver);

/* Channels [us] from MSP, in the wire's order: a frame. Returns false, and nothing has come, when the protocol is
 * another or a channel lies outside NF_CHANNEL_VALID_MIN_US..NF_CHANNEL_VALID_MAX_US. An AUX channel may be
 * NF_CHANNEL_UNTOLD_US: it switches nothing on, whatever the ranges, and is low. */
bool receiver_msp(struct receiver *receiver, const uint16_t channels_us[NF_CHANNEL_COUNT]);

/* One gyro sample has passed. */
void receiver_tick(struct receiver *receiver);

enum receiver_link receiver_link(const struct receiver *receiver);

/* Bit field of enum mode_index: the modes that are on. Lost: none, whatever their ranges. */
uint32_t receiver_modes(const struct receiver *receiver);

/* Channels [us] as they are to be flown now, in the contract's order. Lost: sticks centred, throttle and AUX
 * channels low. With interpolation the sticks that turn the aircraft ramp from one frame to the next. */
void receiver_channels(const struct receiver *receiver, uint16_t channels_us[NF_CHANNEL_COUNT]);

/* 0..100 %: the receiver's own figure if it told one within the last second, else the share of frames. */
unsigned receiver_quality(const struct receiver *receiver);
