#include "common/decimal.h"

#include <stdint.h>
#include <string.h>

#define FRACTION_BITS 23
#define HIDDEN_BIT (1u << FRACTION_BITS)
#define EXPONENT_BIAS 127
#define SIGN_BIT (1u << 31)
#define BEYOND_BITS 0x4B800000u /* of 2^24 */
#define DIGITS 20            /* of 64 bits */
#define COUNT_MOST (UINT64_C(1) << 58) /* another digit, and then a bit more, still fits */
_Static_assert(DECIMAL_BYTES > 1 + DIGITS + 1, "sign, digits, point");

/* A number is `count` units of 10^-places. */
static uint64_t decimal_power_of_ten(unsigned exponent)
{
	uint64_t power = 1;

	while (exponent-- > 0)
		power *= 10u;
	return power;
}

/* --- From text ------------------------------------------------------------------------------------------------ */
/* The bits of the float nearest to count / 10^places. */
static uint32_t decimal_bits(uint64_t count, unsigned places)
{
	uint64_t unit = decimal_power_of_ten(places);
	int exponent = EXPONENT_BIAS - 1; /* of a number from 1/2 to below 1 */
	uint32_t fraction = 0;

	if (count == 0)
		return 0;
	for (; count >= unit; ++exponent)
		unit *= 2u;
	for (; count * 2u < unit; --exponent)
		count *= 2u;
	for (unsigned i = 0; i <= FRACTION_BITS; ++i) {
		const bool bit = (count *= 2u) >= unit;
		count -= bit ? unit : 0;
		fraction = fraction << 1 | bit;
	}
	count *= 2u;
	fraction += count > unit || (count == unit && fraction % 2u == 1u);
	/* A carry into the hidden bit counts the exponent up by one. */
	return ((uint32_t)exponent << FRACTION_BITS) + fraction - HIDDEN_BIT;
}

static bool decimal_is_digit(char c)
{
	return c >= '0' && c <= '9';
}

bool decimal_parse(const char *text, float *value)
{
	const bool negative = *text == '-';
	bool any = false, behind = false;
	uint64_t count = 0;
	unsigned places = 0;

	for (text += *text == '-' || *text == '+'; *text != '\0'; ++text) {
		if (*text == '.' && !behind) {
			behind = true;
			continue;
		}
		if (!decimal_is_digit(*text))
			return false;
		any = true;
		if (count >= COUNT_MOST || places == DECIMAL_PLACES)
			continue;
		count = count * 10u + (uint64_t)(*text - '0');
		places += behind;
	}
	uint32_t bits = decimal_bits(count, places);
	if (!any || bits >= BEYOND_BITS)
		return false;
	bits |= negative ? SIGN_BIT : 0;
	memcpy(value, &bits, sizeof bits);
	return true;
}

/* --- To text -------------------------------------------------------------------------------------------------- */
/* fraction / 2^shift in units of 10^-places, rounded, ties to even. A fraction of 24 bits times 10^12 fits 64 bits. */
static uint64_t decimal_count(uint32_t fraction, unsigned shift, unsigned places)
{
	const uint64_t scaled = fraction * decimal_power_of_ten(places);

	if (shift > 63)
		return shift == 64 && scaled > UINT64_C(1) << 63;
	const uint64_t count = scaled >> shift, rest = scaled - (count << shift), half = (UINT64_C(1) << shift) / 2u;
	return count + (rest > half || (rest == half && rest > 0 && count % 2u == 1u));
}

size_t decimal_format(float value, char text[DECIMAL_BYTES])
{
	uint32_t bits;
	uint64_t count;
	unsigned places = 0;
	size_t n = 0;

	memcpy(&bits, &value, sizeof bits);
	if (bits & SIGN_BIT)
		text[n++] = '-';
	bits &= ~SIGN_BIT;
	const int point = EXPONENT_BIAS + FRACTION_BITS - (int)(bits >> FRACTION_BITS); /* bits behind it */
	const uint32_t fraction = bits < HIDDEN_BIT ? 0 : (bits & (HIDDEN_BIT - 1u)) | HIDDEN_BIT;
	for (;; ++places) {
		count = decimal_count(fraction, point > 0 ? (unsigned)point : 0, places);
		if (point <= 0 || places == DECIMAL_PLACES || decimal_bits(count, places) == bits)
			break;
	}

	bool begun = false;
	for (unsigned place = DIGITS; place-- > 0;) {
		const uint64_t unit = decimal_power_of_ten(place);
		char digit = '0';
		for (; count >= unit; ++digit)
			count -= unit;
		begun |= digit != '0' || place == places;
		if (begun)
			text[n++] = digit;
		if (place == places && places > 0)
			text[n++] = '.';
	}
	text[n] = '\0';
	return n;
}
