#include "storage/card/sd_crc.h"

uint8_t sd_crc7(const uint8_t *bytes, size_t count)
{
	uint32_t crc = 0; /* in bits 1..7 */

	for (size_t i = 0; i < count; ++i) {
		crc ^= bytes[i];
		for (int bit = 0; bit < 8; ++bit)
			crc = (crc << 1 ^ ((crc & 0x80u) != 0u ? 0x12u : 0u)) & 0xFFu;
	}
	return (uint8_t)(crc | 1u);
}

/* A byte at a time without a table: the sum over its bits, written out. */
uint16_t sd_crc16(const uint8_t *bytes, size_t count)
{
	uint32_t crc = 0;

	for (size_t i = 0; i < count; ++i) {
		uint32_t x = crc >> 8 ^ bytes[i];

		x ^= x >> 4;
		crc = (crc << 8 ^ x << 12 ^ x << 5 ^ x) & 0xFFFFu;
	}
	return (uint16_t)crc;
}
