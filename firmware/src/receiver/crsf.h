/* CRSF: bytes in, frames out. Survives any bytes.
 *
 * A frame is sync, length, type, payload, CRC-8/DVB-S2 over type and payload; the length counts from the type to the
 * CRC. Two types are used here, the others are skipped. */
#pragma once

#include "nf_contract.h"

/* All zeros: empty. */
struct crsf {
	uint8_t bytes[NF_CRSF_FRAME_BYTES_MAX];
	uint8_t count;
	uint8_t needed; /* value of `count` at which the bytes are checked next; at most a whole frame */
};

enum crsf_kind {
	CRSF_CHANNELS, /* sticks: `channels_us` */
	CRSF_LINK,     /* link statistics: `quality` */
};

struct crsf_frame {
	enum crsf_kind kind;
	uint16_t channels_us[NF_CHANNEL_COUNT]; /* 880..2159 us */
	uint8_t quality;                        /* of the uplink, 0..100 % */
};

/* Takes bytes until there may be a frame, at most `count`; returns how many. Call crsf_take until it returns
 * false before each call, the first included: until then no more bytes are taken. */
size_t crsf_put(struct crsf *crsf, const uint8_t *bytes, size_t count);

/* Takes out the next whole frame of a kind above; returns whether there was one. One byte may complete several frames:
 * when a supposed frame is none, the search continues after its first byte. `paused`: the line has been silent for
 * longer than a gap inside a frame can be. Then an incomplete frame is none either, and the search continues after its
 * first byte, as bytes that only seemed to begin a frame may be followed by whole ones. When a paused call returns
 * false, nothing is left. */
bool crsf_take(struct crsf *crsf, bool paused, struct crsf_frame *frame);
