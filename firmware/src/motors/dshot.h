/* DShot: motor fractions to 11-bit values, values to 16-bit frames. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

/* 48..2047 for fractions 0..1, clamped; the stop value for NaN. Never a command (1..47). */
uint16_t dshot_value(float fraction);

/* Value (11 bits), telemetry request, checksum: sent most significant bit first. `answered`: on a line that the motor's
 * controller answers on, which it knows by the line's rest level and the inverted checksum. */
uint16_t dshot_frame(uint16_t value, bool telemetry, bool answered);
