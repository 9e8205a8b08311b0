/* DShot: motor fractions to 11-bit values, values to 16-bit frames. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

/* 48..2047 for fractions 0..1, clamped; the stop value for NaN. Never a command (1..47). */
uint16_t dshot_value(float fraction);

/* Two frames, in the halves of a word as their values are: value (11 bits), telemetry request, checksum, sent most significant
 * bit first. `answered`: on lines that the motors' controllers answer on, which they know by the line's rest level and the
 * inverted checksum. */
uint32_t dshot_frames(uint32_t values, bool telemetry, bool answered);
