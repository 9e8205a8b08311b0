/* Text in the making, without the C library. */
#pragma once

#include <stddef.h>

/* What would pass the end is left out; there is always room for the end of a line. */
struct printer {
	char *at;
	const char *end; /* two characters before the buffer's */
};

/* `capacity` at least 2. */
struct printer printer_init(char *buffer, size_t capacity);

/* Prints `format`, in which these stand for values, as in C's printf: %s, %.*s (at most so many characters), %c, %u, %9u
 * (behind spaces, at least so many characters), %08x (the last so many hexadecimal digits) and %%. */
__attribute__((format(printf, 2, 3))) void printer_say(struct printer *p, const char *format, ...);

/* The same, then the end of the line, CR LF. */
__attribute__((format(printf, 2, 3))) void printer_line(struct printer *p, const char *format, ...);

/* Prints a rounded number with `decimals` digits after the point, at most 3; limited to 2 million. */
void printer_fixed(struct printer *p, float value, unsigned decimals);

/* Prints a number with the fewest digits that read back as it (decimal.h). */
void printer_float(struct printer *p, float value);

/* Prints two hexadecimal digits for each byte. */
void printer_bytes(struct printer *p, const void *bytes, size_t count);

/* Ends the line. */
void printer_end(struct printer *p);
