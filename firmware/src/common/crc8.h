/* CRC-8/DVB-S2: the checksum of CRSF and of MSP v2. */
#pragma once

#include <stddef.h>
#include <stdint.h>

/* Goes on from `crc`, 0 at the beginning. Over bytes that end with their own checksum it is 0. */
uint8_t crc8(uint8_t crc, const uint8_t *bytes, size_t count);
