/* Float32 as decimal text and back, exactly, with integers of 64 bits alone: no libm, the same bits on every target. Not for
 * the control step. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

#define DECIMAL_BYTES 24 /* of the longest text of a float, its end included */
#define DECIMAL_PLACES 12 /* behind the point, at most */

/* Writes `value`, whose size is below 2^24, with the fewest places behind the point that read back as it; of several such
 * numbers the nearest. No float from 2^-16 on takes more than DECIMAL_PLACES; a smaller one is rounded to so many. Returns
 * the characters before the 0 that ends them. */
size_t decimal_format(float value, char text[DECIMAL_BYTES]);

/* Reads a decimal number such as 12, -0.5 or .25, rounded to the nearest float, ties to even. Places behind DECIMAL_PLACES
 * do not count. Returns false, *value unchanged, for a number of 2^24 or more, and for what is none. */
bool decimal_parse(const char *text, float *value);
