/* The receiver's line: a queue of bytes, filled by frames. */
#pragma once

#include "hal/host/convert.h"
#include "nf_contract.h"

#define RECEIVER_LINE_FRAMES 8

struct receiver_line {
	uint32_t protocol; /* NF_RECEIVER_PROTOCOL_... */
	uint8_t bytes[RECEIVER_LINE_FRAMES * CONVERT_FRAME_BYTES_MAX];
	size_t count;
};

/* Empties the line; frames put on it from now on are those of `protocol`. */
void receiver_line_start(struct receiver_line *line, uint32_t protocol);

/* Puts one frame of channels [us] on the line. A full line drops the oldest frame. Returns false and puts nothing if
 * the protocol does not use the line. */
bool receiver_line_put(struct receiver_line *line, const uint16_t channels_us[NF_CHANNEL_COUNT]);

/* Takes up to `capacity` bytes off, oldest first; returns how many. */
size_t receiver_line_take(struct receiver_line *line, uint8_t *bytes, size_t capacity);
