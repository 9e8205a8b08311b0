/* What the fuzz targets share. A target is libFuzzer's LLVMFuzzerTestOneInput; clang links it with libFuzzer, gcc with
 * replay.c, which runs the seeds. Each input starts from the same state: the same bytes do the same. */
#ifndef FUZZ_H
#define FUZZ_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* A promise of the firmware that an input has broken: both programs end and keep the input. */
#define PROMISE(holds)                                                                      \
	do {                                                                                \
		if (!(holds)) {                                                             \
			fprintf(stderr, "%s:%d: broken: %s\n", __FILE__, __LINE__, #holds); \
			abort();                                                            \
		}                                                                           \
	} while (0)

/* What is left of the input. */
struct input {
	const uint8_t *at;
	size_t left;
};

/* The next byte, 0 behind the end. */
static inline unsigned input_byte(struct input *input)
{
	if (input->left == 0)
		return 0;
	--input->left;
	return *input->at++;
}

/* The next `count` bytes, at most what is left, in a heap block of that size, so that one byte too far is seen. The
 * caller frees it. */
static inline uint8_t *input_bytes(struct input *input, size_t *count)
{
	if (*count > input->left)
		*count = input->left;
	uint8_t *const bytes = malloc(*count ? *count : 1);
	if (!bytes)
		abort();
	memcpy(bytes, input->at, *count);
	input->at += *count;
	input->left -= *count;
	return bytes;
}

#endif
