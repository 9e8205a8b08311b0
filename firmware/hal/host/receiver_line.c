#include "hal/host/receiver_line.h"

#include <string.h>

#include "hal/host/convert.h"

static void receiver_line_drop(struct receiver_line *line, size_t count)
{
	line->count -= count;
	memmove(line->bytes, line->bytes + count, line->count);
}

void receiver_line_put(struct receiver_line *line, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	if (line->count + NF_SBUS_FRAME_BYTES > sizeof line->bytes)
		receiver_line_drop(line, NF_SBUS_FRAME_BYTES);
	convert_channels(channels_us, line->bytes + line->count);
	line->count += NF_SBUS_FRAME_BYTES;
}

size_t receiver_line_take(struct receiver_line *line, uint8_t *bytes, size_t capacity)
{
	const size_t count = line->count < capacity ? line->count : capacity;

	memcpy(bytes, line->bytes, count);
	receiver_line_drop(line, count);
	return count;
}
