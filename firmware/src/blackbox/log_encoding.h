/* How the ecosystem's blackbox writes numbers (data version 2). Each function writes behind *at and moves it on; the caller
 * has room. */
#pragma once

#include <stdint.h>

/* Numbers of the encodings in a log's header. */
enum log_encoding {
	LOG_SIGNED = 0, /* variable bytes, small magnitudes short: the sign is the lowest bit */
	LOG_UNSIGNED = 1, /* variable bytes: 7 bits each, the lowest first, bit 7: more follow */
	LOG_TAG8_8SVB =
		6, /* up to 8 fields: a byte of bits, which are not 0; those as LOG_SIGNED. A single one without it */
	LOG_TAG2_3S32 = 7, /* 3 fields: all in 2, 4 or 6 bits, or each in 1 to 4 bytes */
	LOG_NOTHING = 9, /* the predictor alone */
};

#define LOG_VARIABLE_MAX 5u /* bytes of a variable number */

void log_put_unsigned(uint8_t **at, uint32_t value);
void log_put_signed(uint8_t **at, int32_t value);

/* count: 1 to 8. */
void log_put_tag8_8svb(uint8_t **at, const int32_t values[], unsigned count);

/* Within 24 bits. */
void log_put_tag2_3s32(uint8_t **at, const int32_t values[3]);
