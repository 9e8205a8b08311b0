/* Payloads of MSP: little-endian numbers and texts, put in and taken out one after the other. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#define MSP_TEXT_MAX 32u /* of a counted text; what is longer is cut */

/* A payload in the making; what would pass its end is left out. */
struct msp_writer {
	uint8_t *at;
	const uint8_t *end;
};

void msp_put_u8(struct msp_writer *w, unsigned value);
void msp_put_u16(struct msp_writer *w, unsigned value);
void msp_put_u32(struct msp_writer *w, uint32_t value);
void msp_put_float(struct msp_writer *w, float value);
void msp_put_bytes(struct msp_writer *w, const void *bytes, size_t count);
void msp_put_zeros(struct msp_writer *w, unsigned count);

/* `value` rounded and held within 16 bits, signed; 0 for NaN. */
void msp_put_rounded(struct msp_writer *w, float value);

/* Up to its end or `most` characters. */
void msp_put_text(struct msp_writer *w, const char *text, unsigned most);

/* The same, preceded by a byte with the count. */
void msp_put_counted_text(struct msp_writer *w, const char *text, unsigned most);

/* The unread rest of a payload; reading past its end gives zeros. */
struct msp_reader {
	const uint8_t *at;
	size_t left; /* bytes */
};

unsigned msp_take_u8(struct msp_reader *r);
unsigned msp_take_u16(struct msp_reader *r);
uint32_t msp_take_u32(struct msp_reader *r);
