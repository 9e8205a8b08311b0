/* The four functions that a compiler may call from any C code (GCC manual, "Standards": freestanding). */
#include <stddef.h>
#include <stdint.h>

void *memcpy(void *restrict to, const void *restrict from, size_t count);
void *memmove(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);
int memcmp(const void *left, const void *right, size_t count);

/* A word that may lie over anything. */
typedef uint32_t __attribute__((may_alias)) word;

static int memory_both_aligned(const void *a, const void *b)
{
	return (((uintptr_t)a | (uintptr_t)b) & 3u) == 0u;
}

void *memcpy(void *restrict to, const void *restrict from, size_t count)
{
	uint8_t *out = to;
	const uint8_t *in = from;

	if (memory_both_aligned(out, in)) {
		for (; count >= 4u * sizeof(word); count -= 4u * sizeof(word)) {
			const word *const from_four = (const void *)in;
			word *const four = (void *)out;
			const word a = from_four[0], b = from_four[1], c = from_four[2], d = from_four[3];

			four[0] = a;
			four[1] = b;
			four[2] = c;
			four[3] = d;
			in += 4u * sizeof(word);
			out += 4u * sizeof(word);
		}
		for (; count >= sizeof(word); count -= sizeof(word), out += sizeof(word), in += sizeof(word))
			*(word *)(void *)out = *(const word *)(const void *)in;
	}
	while (count-- != 0u)
		*out++ = *in++;
	return to;
}

void *memmove(void *to, const void *from, size_t count)
{
	uint8_t *out = to;
	const uint8_t *in = from;

	if ((uintptr_t)out < (uintptr_t)in) {
		while (count-- != 0u)
			*out++ = *in++;
	} else {
		while (count-- != 0u)
			out[count] = in[count];
	}
	return to;
}

void *memset(void *to, int value, size_t count)
{
	uint8_t *out = to;
	const word filled = (uint8_t)value * 0x01010101u;

	for (; count != 0u && !memory_both_aligned(out, out); --count)
		*out++ = (uint8_t)value;
	for (; count >= 4u * sizeof(word); count -= 4u * sizeof(word), out += 4u * sizeof(word)) {
		word *const four = (void *)out;
		four[0] = filled;
		four[1] = filled;
		four[2] = filled;
		four[3] = filled;
	}
	for (; count != 0u; --count)
		*out++ = (uint8_t)value;
	return to;
}

int memcmp(const void *left, const void *right, size_t count)
{
	const uint8_t *a = left, *b = right;

	for (; count != 0u; --count, ++a, ++b)
		if (*a != *b)
			return *a < *b ? -1 : 1;
	return 0;
}
