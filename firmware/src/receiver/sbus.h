/* SBUS and S.BUS2: bytes in, frames out. Survives any bytes. */
#pragma once

#include "nf_contract.h"

struct sbus {
	uint8_t bytes[NF_SBUS_FRAME_BYTES]; /* begins with a header, or is empty */
	uint8_t count;                      /* below NF_SBUS_FRAME_BYTES between calls */
};

struct sbus_frame {
	uint16_t channels_us[NF_CHANNEL_COUNT]; /* 880..2159 us */
	bool frame_lost;                        /* the receiver missed this one and repeats the last */
	bool failsafe;                          /* the receiver has lost its transmitter */
};

/* Empty. Also called when the line has been silent for longer than a gap inside a frame can be. */
void sbus_reset(struct sbus *sbus);

/* Takes one byte. Returns whether it completed a frame, which is then in `frame`; otherwise `frame` is
 * left alone. SBUS has no checksum: a frame is 25 bytes with the right first, flag and last one. */
bool sbus_push(struct sbus *sbus, uint8_t byte, struct sbus_frame *frame);

/* Takes bytes that sbus_push would only keep, because they lie within a frame; returns how many, at most `count`. */
size_t sbus_fill(struct sbus *sbus, const uint8_t *bytes, size_t count);
