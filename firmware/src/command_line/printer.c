#include "command_line/printer.h"

#include "common/limit.h"

#define DIGITS_MAX 10
#define FIXED_MOST 2e6f /* times 1000 it is a 32-bit number */

struct printer printer_init(char *buffer, size_t capacity)
{
	return (struct printer){ buffer, buffer + capacity - 2 };
}

void printer_char(struct printer *p, char c)
{
	if (p->at < p->end)
		*p->at++ = c;
}

void printer_part(struct printer *p, const char *text, size_t most)
{
	for (; most > 0 && *text != '\0'; --most)
		printer_char(p, *text++);
}

void printer_text(struct printer *p, const char *text)
{
	printer_part(p, text, SIZE_MAX);
}

void printer_column(struct printer *p, uint32_t value, unsigned width)
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

void printer_number(struct printer *p, uint32_t value)
{
	printer_column(p, value, 0);
}

void printer_fixed(struct printer *p, float value, unsigned decimals)
{
	static const uint32_t scales[] = { 1, 10, 100, 1000 };
	const uint32_t scale = scales[decimals];
	const float size = limit(value < 0.0f ? -value : value, 0.0f, FIXED_MOST);
	const uint32_t scaled = (uint32_t)(size * (float)scale + 0.5f);

	if (value < 0.0f && scaled > 0)
		printer_char(p, '-');
	printer_number(p, scaled / scale);
	if (decimals == 0)
		return;
	printer_char(p, '.');
	for (uint32_t digit = scale / 10u; digit > 0; digit /= 10u)
		printer_char(p, (char)('0' + scaled / digit % 10u));
}

void printer_hex(struct printer *p, uint32_t value, unsigned digits)
{
	static const char names[] = "0123456789abcdef";

	while (digits-- > 0)
		printer_char(p, names[value >> 4u * digits & 0xFu]);
}

void printer_end(struct printer *p)
{
	*p->at++ = '\r';
	*p->at++ = '\n';
}
