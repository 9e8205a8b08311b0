/* Sequence numbers that wrap: of two, the newer one is less than half of all numbers ahead (RFC 1982, section 3). */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#define SERIAL_NUMBER_HALF 0x80000000u

/* Is `a` newer than `b`? Of two that are half of all numbers apart neither is. */
static inline bool serial_number_newer(uint32_t a, uint32_t b)
{
	const uint32_t ahead = a - b;

	return ahead != 0 && ahead < SERIAL_NUMBER_HALF;
}
