/* Streaming telemetry: records of control steps, sent to a peer unsolicited at the granted rate. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/status.h"

struct msp_stream {
	uint32_t divider;  /* control steps a record; 0: no stream */
	uint32_t due;      /* control step of the next record */
	uint16_t sequence; /* its number: all that were due are counted, those that could not be sent too */
};

/* Records from control step `step` + 1 on. Returns the granted rate: the greatest divisor of the control rate that is
 * neither above `rate_hz` nor above NF_MSP_STREAM_RATE_MAX_HZ. rate_hz 0 ends the stream. */
unsigned msp_stream_start(struct msp_stream *stream, unsigned rate_hz, uint32_t step);

void msp_stream_stop(struct msp_stream *stream);

/* Is a record due, now that control step `step` is done? */
bool msp_stream_due(const struct msp_stream *stream, uint32_t step);

/* Writes `record`, the due one, as a frame, and counts it and those that were due before. Returns its bytes; 0 if it does
 * not fit into `capacity`: then it is dropped whole. */
size_t msp_stream_write(struct msp_stream *stream, const struct control_record *record, uint8_t *frame,
			size_t capacity);
