/* Receiver: the last channels, how old they are in gyro samples, and what is flown when they stay away. */
#ifndef NF_RECEIVER_H
#define NF_RECEIVER_H

#include <stdint.h>

#include "nf_contract.h"
#include "sbus.h"

enum receiver_link {
	RECEIVER_LOST, /* never heard, silent for NF_RECEIVER_LOST_MS, or in failsafe: motors stop */
	RECEIVER_HOLD, /* silent for NF_RECEIVER_HOLD_MS: rates centred, throttle kept */
	RECEIVER_GOOD,
};

struct receiver {
	uint16_t channels_us[NF_CHANNEL_COUNT]; /* of the last good frame */
	uint32_t age;                           /* gyro samples since that frame, at most lost_after */
	uint32_t hold_after;                    /* gyro samples */
	uint32_t lost_after;
};

/* Starts lost. */
void receiver_init(struct receiver *receiver, unsigned gyro_rate_hz);

/* A frame has come. A repeated one (frame_lost) is no news and ages; failsafe means lost at once. */
void receiver_frame(struct receiver *receiver, const struct sbus_frame *frame);

/* One gyro sample has passed. */
void receiver_tick(struct receiver *receiver);

enum receiver_link receiver_link(const struct receiver *receiver);

/* Channels [us] as they are to be flown now. Lost: sticks centred, throttle and all switches low. */
void receiver_channels(const struct receiver *receiver, uint16_t channels_us[NF_CHANNEL_COUNT]);

#endif
