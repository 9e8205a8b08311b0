#include "common/printer.h"

#include <stdarg.h>
#include <stdint.h>

#include "common/decimal.h"
#include "common/limit.h"

#define DIGITS_MAX 10
#define FIXED_MOST 2e6f /* times 1000 it is a 32-bit number */

struct printer printer_init(char *buffer, size_t capacity)
{
	return (struct printer){ buffer, buffer + capacity - 2 };
}

static void printer_char(struct printer *p, char c)
{
	if (p->at < p->end)
		*p->at++ = c;
}

static void printer_text(struct printer *p, const char *text, size_t most)
{
	for (; most > 0 && *text != '\0'; --most)
		printer_char(p, *text++);
}

static void printer_number(struct printer *p, uint32_t value, unsigned width)
{
	char digits[DIGITS_MAX];
	unsigned count = 0;

	do
		digits[count++] = (char)('0' + value % 10u);
	while ((value /= 10u) != 0);
	for (unsigned i = count; i < width; ++i)
		printer_char(p, ' ');
	while (count > 0)
		printer_char(p, digits[--count]);
}

static void printer_hex(struct printer *p, uint32_t value, unsigned digits)
{
	static const char names[] = "0123456789abcdef";

	while (digits-- > 0)
		printer_char(p, names[value >> 4u * digits & 0xFu]);
}

static void printer_values(struct printer *p, const char *format, va_list values)
{
	for (; *format != '\0'; ++format) {
		unsigned width = 0;
		size_t most = SIZE_MAX;

		if (*format != '%') {
			printer_char(p, *format);
			continue;
		}
		for (++format; *format >= '0' && *format <= '9'; ++format)
			width = width * 10u + (unsigned)(*format - '0');
		if (*format == '.') {
			most = (size_t)va_arg(values, int);
			format += 2; /* .* */
		}
		if (*format == 's')
			printer_text(p, va_arg(values, const char *), most);
		else if (*format == 'u')
			printer_number(p, va_arg(values, unsigned), width);
		else if (*format == 'x')
			printer_hex(p, va_arg(values, unsigned), width);
		else
			printer_char(p, *format == 'c' ? (char)va_arg(values, int) : *format);
	}
}

void printer_say(struct printer *p, const char *format, ...)
{
	va_list values;

	va_start(values, format);
	printer_values(p, format, values);
	va_end(values);
}

void printer_line(struct printer *p, const char *format, ...)
{
	va_list values;

	va_start(values, format);
	printer_values(p, format, values);
	va_end(values);
	printer_end(p);
}

void printer_end(struct printer *p)
{
	*p->at++ = '\r';
	*p->at++ = '\n';
}

void printer_fixed(struct printer *p, float value, unsigned decimals)
{
	static const uint32_t scales[] = { 1, 10, 100, 1000 };
	const uint32_t scale = scales[decimals];
	const float size = limit(value < 0.0f ? -value : value, 0.0f, FIXED_MOST);
	const uint32_t scaled = (uint32_t)(size * (float)scale + 0.5f);

	if (value < 0.0f && scaled > 0)
		printer_char(p, '-');
	printer_number(p, scaled / scale, 0);
	if (decimals == 0)
		return;
	printer_char(p, '.');
	for (uint32_t digit = scale / 10u; digit > 0; digit /= 10u)
		printer_char(p, (char)('0' + scaled / digit % 10u));
}

void printer_float(struct printer *p, float value)
{
	char text[DECIMAL_BYTES];
	const size_t count = decimal_format(value, text);

	printer_text(p, text, count);
}

void printer_bytes(struct printer *p, const void *bytes, size_t count)
{
	for (size_t i = 0; i < count; ++i)
		printer_hex(p, ((const uint8_t *)bytes)[i], 2);
}
