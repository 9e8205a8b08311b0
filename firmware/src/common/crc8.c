#include "common/crc8.h"

#include "nf_contract.h"

/* Remainders of the four top bits of the CRC. Processing half a byte at a time needs 16 bytes of table and a quarter
 * of the steps of single bits. */
static const uint8_t shifted[16] = {
	0x00, 0xD5, 0x7F, 0xAA, 0xFE, 0x2B, 0x81, 0x54, 0x29, 0xFC, 0x56, 0x83, 0xD7, 0x02, 0xA8, 0x7D,
};
_Static_assert(NF_CRC8_DVB_S2_POLY == 0xD5, "the table is another polynomial's");

uint8_t crc8(uint8_t crc, const uint8_t *bytes, size_t count)
{
	for (size_t i = 0; i < count; ++i) {
		crc ^= bytes[i];
		crc = (uint8_t)(crc << 4 ^ shifted[crc >> 4]);
		crc = (uint8_t)(crc << 4 ^ shifted[crc >> 4]);
	}
	return crc;
}
