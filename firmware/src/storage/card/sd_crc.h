/* Checksums of SD cards (Physical Layer Simplified Specification 4.5). */
#pragma once

#include <stddef.h>
#include <stdint.h>

/* The last byte of a command: x^7 + x^3 + 1, then the end bit. */
uint8_t sd_crc7(const uint8_t *bytes, size_t count);
/* Returns the CRC-16 of data blocks: x^16 + x^12 + x^5 + 1. */
uint16_t sd_crc16(const uint8_t *bytes, size_t count);
