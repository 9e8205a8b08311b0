#include "common/crc32.h"

/* Reflected 0xEDB88320, begun and ended with all ones. Sixteen entries and two steps a byte: 12 cycles, 3 ms for
 * the largest policy blob at 216 MHz. The usual 256 entries would take 7 cycles and 960 bytes more of flash; for
 * once at boot the smaller table is the better one. */
uint32_t crc32_more(uint32_t crc, const void *bytes, size_t count)
{
	static const uint32_t table[16] = {
		0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
		0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
	};
	const uint8_t *in = bytes;

	crc = ~crc;
	for (size_t i = 0; i < count; ++i) {
		crc ^= in[i];
		crc = crc >> 4 ^ table[crc & 0xFu];
		crc = crc >> 4 ^ table[crc & 0xFu];
	}
	return ~crc;
}
