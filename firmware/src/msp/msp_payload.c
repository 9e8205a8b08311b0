#include "msp/msp_payload.h"

#include <string.h>

#include "common/limit.h"

void msp_put_u8(struct msp_writer *w, unsigned value)
{
	if (w->at < w->end)
		*w->at++ = (uint8_t)value;
}

void msp_put_u16(struct msp_writer *w, unsigned value)
{
	msp_put_u8(w, value);
	msp_put_u8(w, value >> 8);
}

void msp_put_u32(struct msp_writer *w, uint32_t value)
{
	msp_put_u16(w, value);
	msp_put_u16(w, value >> 16);
}

void msp_put_float(struct msp_writer *w, float value)
{
	uint32_t bits;

	memcpy(&bits, &value, sizeof bits);
	msp_put_u32(w, bits);
}

void msp_put_bytes(struct msp_writer *w, const void *bytes, size_t count)
{
	const uint8_t *from = bytes;

	for (size_t i = 0; i < count; ++i)
		msp_put_u8(w, from[i]);
}

void msp_put_zeros(struct msp_writer *w, unsigned count)
{
	while (count-- > 0)
		msp_put_u8(w, 0);
}

void msp_put_rounded(struct msp_writer *w, float value)
{
	const float held = value == value ? limit(value, INT16_MIN, INT16_MAX) : 0.0f;

	msp_put_u16(w, (uint16_t)(int16_t)(held < 0.0f ? held - 0.5f : held + 0.5f));
}

void msp_put_text(struct msp_writer *w, const char *text, unsigned most)
{
	for (unsigned i = 0; i < most && text[i]; ++i)
		msp_put_u8(w, (unsigned char)text[i]);
}

void msp_put_counted_text(struct msp_writer *w, const char *text, unsigned most)
{
	unsigned length = 0;

	while (length < most && length < MSP_TEXT_MAX && text[length])
		++length;
	msp_put_u8(w, length);
	msp_put_text(w, text, length);
}

unsigned msp_take_u8(struct msp_reader *r)
{
	if (r->left == 0)
		return 0;
	--r->left;
	return *r->at++;
}

unsigned msp_take_u16(struct msp_reader *r)
{
	const unsigned low = msp_take_u8(r);

	return low | msp_take_u8(r) << 8;
}

uint32_t msp_take_u32(struct msp_reader *r)
{
	const uint32_t low = msp_take_u16(r);

	return low | (uint32_t)msp_take_u16(r) << 16;
}
