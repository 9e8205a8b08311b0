#include "receiver/sbus.h"

#include <string.h>

#include "receiver/channels.h"

#define FLAGS (NF_SBUS_FRAME_BYTES - 2)
#define FOOTER (NF_SBUS_FRAME_BYTES - 1)
#define FLAGS_UNUSED 0xF0u /* always 0 in a true frame, as NF_SBUS_FOOTER_UNUSED is in the footer */
_Static_assert(1 + CHANNELS_PACKED_BYTES == FLAGS, "header, channels, flags, footer");

void sbus_reset(struct sbus *sbus)
{
	sbus->count = 0;
}

static void sbus_decode(const uint8_t bytes[NF_SBUS_FRAME_BYTES], struct sbus_frame *frame)
{
	channels_unpack(bytes + 1, frame->channels_us);
	frame->frame_lost = bytes[FLAGS] & NF_SBUS_FLAG_FRAME_LOST;
	frame->failsafe = bytes[FLAGS] & NF_SBUS_FLAG_FAILSAFE;
}

/* The format has no checksum. The unused bits reveal most frames that begin a byte early or late. */
static bool sbus_framed(const uint8_t bytes[NF_SBUS_FRAME_BYTES])
{
	return (bytes[FOOTER] & NF_SBUS_FOOTER_UNUSED) == 0 && (bytes[FLAGS] & FLAGS_UNUSED) == 0;
}

/* Drops the first byte and all others before the next that can begin a frame. */
static void sbus_resume_at_next_header(struct sbus *sbus)
{
	uint8_t from = 1;

	while (from < sbus->count && sbus->bytes[from] != NF_SBUS_HEADER)
		++from;
	for (uint8_t i = from; i < sbus->count; ++i)
		sbus->bytes[i - from] = sbus->bytes[i];
	sbus->count = (uint8_t)(sbus->count - from);
}

bool sbus_push(struct sbus *sbus, uint8_t byte, struct sbus_frame *frame)
{
	if (sbus->count == 0 && byte != NF_SBUS_HEADER)
		return false;
	sbus->bytes[sbus->count++] = byte;
	if (sbus->count < NF_SBUS_FRAME_BYTES)
		return false;
	if (!sbus_framed(sbus->bytes)) {
		sbus_resume_at_next_header(sbus);
		return false;
	}
	sbus_decode(sbus->bytes, frame);
	sbus_reset(sbus);
	return true;
}

size_t sbus_fill(struct sbus *sbus, const uint8_t *bytes, size_t count)
{
	if (sbus->count == 0)
		return 0;
	const size_t room = NF_SBUS_FRAME_BYTES - 1u - sbus->count;
	const size_t taken = count < room ? count : room;

	memcpy(sbus->bytes + sbus->count, bytes, taken);
	sbus->count = (uint8_t)(sbus->count + taken);
	return taken;
}
