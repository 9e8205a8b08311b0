#include "blackbox/log_text.h"

#include "common/decimal.h"

void log_text(char **at, const char *text)
{
	while (*text)
		*(*at)++ = *text++;
}

void log_text_whole(char **at, uint32_t value)
{
	uint32_t unit = 1;

	while (value / unit > 9)
		unit *= 10;
	for (; unit > 0; unit /= 10)
		*(*at)++ = (char)('0' + value / unit % 10);
}

void log_text_number(char **at, int32_t value)
{
	if (value < 0)
		*(*at)++ = '-';
	log_text_whole(at, value < 0 ? 0u - (uint32_t)value : (uint32_t)value);
}

static void log_text_digits(char **at, uint32_t value, unsigned digits)
{
	while (digits-- > 0)
		*(*at)++ = "0123456789abcdef"[value >> 4 * digits & 15u];
}

void log_text_hex(char **at, uint32_t value)
{
	log_text_digits(at, value, 8);
}

void log_text_bytes(char **at, const void *bytes, size_t count)
{
	const uint8_t *byte = bytes;

	for (size_t i = 0; i < count; ++i)
		log_text_digits(at, byte[i], 2);
}

void log_text_float(char **at, float value)
{
	*at += decimal_format(value, *at);
}
