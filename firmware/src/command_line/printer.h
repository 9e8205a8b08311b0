/* Lines of text in the making, without the C library. */
#ifndef NF_PRINTER_H
#define NF_PRINTER_H

#include <stddef.h>
#include <stdint.h>

/* What would pass the end of a line is left out; there is always room for the line's end. */
struct printer {
	char *at;
	const char *end; /* two characters before the buffer's */
};

/* `capacity` at least 2. */
struct printer printer_init(char *buffer, size_t capacity);

void printer_char(struct printer *p, char c);
void printer_text(struct printer *p, const char *text);

/* Up to its end or `most` characters. */
void printer_part(struct printer *p, const char *text, size_t most);

void printer_number(struct printer *p, uint32_t value);

/* `value` behind spaces that make it `width` characters at least. */
void printer_column(struct printer *p, uint32_t value, unsigned width);

/* Prints a rounded number with `decimals` digits after the point, at most 3; limited to 2 million. */
void printer_fixed(struct printer *p, float value, unsigned decimals);

/* The last `digits` hexadecimal digits. */
void printer_hex(struct printer *p, uint32_t value, unsigned digits);

/* Ends the line: CR LF. */
void printer_end(struct printer *p);

#endif
