#include "hal/host/receiver_line.h"

#include <string.h>

#include "hal/host/convert.h"

static void receiver_line_drop(struct receiver_line *line, size_t count)
{
	line->count -= count;
	memmove(line->bytes, line->bytes + count, line->count);
}

void receiver_line_start(struct receiver_line *line, uint32_t protocol)
{
	*line = (struct receiver_line){ .protocol = protocol };
}

bool receiver_line_put(struct receiver_line *line, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	uint8_t frame[CONVERT_FRAME_BYTES_MAX];
	const size_t size = convert_frame(line->protocol, channels_us, frame);

	if (line->count + size > RECEIVER_LINE_FRAMES * size)
		receiver_line_drop(line, size);
	memcpy(line->bytes + line->count, frame, size);
	line->count += size;
	return size > 0;
}

size_t receiver_line_take(struct receiver_line *line, uint8_t *bytes, size_t capacity)
{
	const size_t count = line->count < capacity ? line->count : capacity;

	memcpy(bytes, line->bytes, count);
	receiver_line_drop(line, count);
	return count;
}
