/* Float32 as decimal text and back, exactly, with integers alone: no libm, the same bits on every target. Not for the
 * control step. */
#ifndef NF_DECIMAL_H
#define NF_DECIMAL_H

#include <stdbool.h>
#include <stddef.h>

#define DECIMAL_BYTES 20     /* of the longest text of a float, its end included */
#define DECIMAL_DIGITS_MAX 30 /* significant ones that are read */

/* Writes the decimal number with the fewest digits that reads back as `value`; of several, the nearest. "nan" and "inf"
 * for what is no number. Returns the characters before the 0 that ends them. */
size_t decimal_format(float value, char text[DECIMAL_BYTES]);

/* Reads a decimal number such as 12, -0.5 or 1.5e-7, rounded to the nearest float, ties to even; too large a one is
 * infinite. Returns false, *value unchanged, for anything else, and for more than DECIMAL_DIGITS_MAX digits that count. */
bool decimal_parse(const char *text, float *value);

#endif
