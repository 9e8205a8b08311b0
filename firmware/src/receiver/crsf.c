#include "receiver/crsf.h"

#include <string.h>

#include "common/crc8.h"
#include "receiver/channels.h"

/* Where things stand in a frame. */
#define LENGTH 1
#define TYPE 2
#define PAYLOAD 3
/* Values of the length: type, payload and CRC. */
#define LENGTH_MIN 2u
#define LENGTH_MAX (NF_CRSF_FRAME_BYTES_MAX - 2u)
/* Shortest lengths: newer senders may append fields. */
#define CHANNELS_LENGTH (CHANNELS_PACKED_BYTES + 2u)
#define LINK_LENGTH (10u + 2u) /* RSSI of two antennas stands before the uplink's quality */
#define LINK_QUALITY (PAYLOAD + 2)
#define PERCENT_MAX 100u

size_t crsf_put(struct crsf *crsf, const uint8_t *bytes, size_t count)
{
	const size_t wanted = (size_t)(crsf->needed - crsf->count);
	const size_t taken = count < wanted ? count : wanted;

	memcpy(crsf->bytes + crsf->count, bytes, taken);
	crsf->count = (uint8_t)(crsf->count + taken);
	return taken;
}

/* How many bytes to remove: those of a whole frame, 1 when no frame begins here, 0 when a frame may still be
 * incomplete. */
static size_t crsf_check(const uint8_t *bytes, size_t count)
{
	if (count > 0 && bytes[0] != NF_CRSF_SYNC)
		return 1;
	if (count <= LENGTH)
		return 0;
	const size_t length = bytes[LENGTH];
	if (length < LENGTH_MIN || length > LENGTH_MAX)
		return 1;
	if (count < TYPE + length)
		return 0;
	return crc8(0, bytes + TYPE, length) == 0 ? TYPE + length : 1;
}

/* Reads a whole frame; returns whether it is of a kind that matters. */
static bool crsf_decode(const uint8_t *bytes, struct crsf_frame *frame)
{
	const size_t length = bytes[LENGTH];

	if (bytes[TYPE] == NF_CRSF_TYPE_CHANNELS && length >= CHANNELS_LENGTH) {
		frame->kind = CRSF_CHANNELS;
		channels_unpack(bytes + PAYLOAD, frame->channels_us);
		return true;
	}
	if (bytes[TYPE] == NF_CRSF_TYPE_LINK && length >= LINK_LENGTH) {
		const uint8_t quality = bytes[LINK_QUALITY];
		frame->kind = CRSF_LINK;
		frame->quality = quality < PERCENT_MAX ? quality : PERCENT_MAX;
		return true;
	}
	return false;
}

/* The loop ends because each round removes at least one byte. The rest is shorter than the longest frame; after a
 * pause it is empty. */
bool crsf_take(struct crsf *crsf, bool paused, struct crsf_frame *frame)
{
	size_t from = 0;
	bool taken = false;

	while (!taken && from < crsf->count) {
		size_t done = crsf_check(crsf->bytes + from, crsf->count - from);
		if (done == 0 && !paused)
			break;
		taken = done > 1 && crsf_decode(crsf->bytes + from, frame);
		from += done > 0 ? done : 1;
	}
	crsf->count = (uint8_t)(crsf->count - from);
	if (from > 0)
		memmove(crsf->bytes, crsf->bytes + from, crsf->count);
	/* After a frame the rest is still to be checked; without one the rest is the beginning of a frame. */
	if (taken)
		crsf->needed = crsf->count;
	else
		crsf->needed = (uint8_t)(crsf->count > LENGTH ? TYPE + crsf->bytes[LENGTH] : crsf->count + 1);
	return taken;
}
