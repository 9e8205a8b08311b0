/* CRC-32 of IEEE 802.3, the one of zlib and PNG: of policy blobs and of everything kept in flash. */
#pragma once

#include <stddef.h>
#include <stdint.h>

/* The CRC of all bytes so far and of `count` more. `crc`: of those so far, 0 of none. 12 cycles a byte. */
uint32_t crc32_more(uint32_t crc, const void *bytes, size_t count);
