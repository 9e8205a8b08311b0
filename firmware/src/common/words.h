/* Copying whole words in as few instructions as the compiler can: for the gyro's interrupt, where a call of memcpy would take
 * five a word. */
#pragma once

#include <stddef.h>
#include <stdint.h>

struct words_1 {
	uint32_t word[1];
} __attribute__((may_alias));

struct words_2 {
	uint32_t word[2];
} __attribute__((may_alias));

struct words_4 {
	uint32_t word[4];
} __attribute__((may_alias));

struct words_16 {
	uint32_t word[16];
} __attribute__((may_alias));

/* bytes: a constant, a multiple of 4. Both places are aligned to 4 and do not overlap. */
static inline __attribute__((always_inline)) void words_copy(void *to, const void *from, size_t bytes)
{
	uint8_t *out = to;
	const uint8_t *in = from;

#define WORDS_PART(part)                                        \
	do {                                                    \
		*(struct part *)out = *(const struct part *)in; \
		out += sizeof(struct part);                     \
		in += sizeof(struct part);                      \
		bytes -= sizeof(struct part);                   \
	} while (0)
	while (bytes >= sizeof(struct words_16))
		WORDS_PART(words_16);
	if (bytes >= 2u * sizeof(struct words_4))
		WORDS_PART(words_4);
	if (bytes >= sizeof(struct words_4))
		WORDS_PART(words_4);
	if (bytes >= sizeof(struct words_4))
		WORDS_PART(words_4);
	if (bytes >= sizeof(struct words_2))
		WORDS_PART(words_2);
	if (bytes >= sizeof(struct words_1))
		*(struct words_1 *)out = *(const struct words_1 *)in;
#undef WORDS_PART
}
