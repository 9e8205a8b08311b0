#include "common/decimal.h"

#include <stdint.h>
#include <string.h>

#define FRACTION_BITS 23
#define HIDDEN_BIT (1u << FRACTION_BITS)
#define EXPONENT_LEAST (-149) /* of the last bit */
#define EXPONENT_MOST 104
#define SIGN_BIT (1u << 31)
#define INFINITE_BITS 0x7F800000u
#define SHORTEST_DIGITS 9 /* the most that a float needs to read back */
/* A decimal point stands among the digits of numbers from 1e-5 to 1e10; others have an exponent. */
#define PLAIN_LEAST (-4)
#define PLAIN_MOST 10
#define EXPONENT_SEEN_MAX 10000 /* further digits of an exponent change nothing */
#define DECIMAL_MOST 39   /* 1e39 is above all floats, */
#define DECIMAL_LEAST (-46) /* 1e-46 below half of the least one */

/* --- Large whole numbers ----------------------------------------------------------------------------------- */
#define LIMBS 10u

/* Least limb first. The largest that is needed: 10^76 * 2^25, 278 bits. */
struct large {
	uint32_t limb[LIMBS];
};

static struct large decimal_large(uint32_t value)
{
	return (struct large){ .limb = { value } };
}

/* Times `factor`, plus `more`. */
static void decimal_multiply(struct large *a, uint32_t factor, uint32_t more)
{
	uint64_t carry = more;

	for (unsigned i = 0; i < LIMBS; ++i) {
		carry += (uint64_t)a->limb[i] * factor;
		a->limb[i] = (uint32_t)carry;
		carry >>= 32;
	}
}

static void decimal_scale(struct large *a, uint32_t factor, int times)
{
	while (times-- > 0)
		decimal_multiply(a, factor, 0);
}

/* a + b; a - b where that is not negative. */
static struct large decimal_add(const struct large *a, const struct large *b)
{
	struct large sum;
	uint64_t carry = 0;

	for (unsigned i = 0; i < LIMBS; ++i) {
		carry += (uint64_t)a->limb[i] + b->limb[i];
		sum.limb[i] = (uint32_t)carry;
		carry >>= 32;
	}
	return sum;
}

static void decimal_subtract(struct large *a, const struct large *b)
{
	uint64_t borrow = 0;

	for (unsigned i = 0; i < LIMBS; ++i) {
		const uint64_t difference = (uint64_t)a->limb[i] - b->limb[i] - borrow;
		a->limb[i] = (uint32_t)difference;
		borrow = difference >> 63;
	}
}

/* Negative, 0 or positive, as a is below, at or above b. */
static int decimal_compare(const struct large *a, const struct large *b)
{
	for (unsigned i = LIMBS; i-- > 0;)
		if (a->limb[i] != b->limb[i])
			return a->limb[i] < b->limb[i] ? -1 : 1;
	return 0;
}

/* --- To text ------------------------------------------------------------------------------------------------- */
/* value = rest / unit; half the way to its neighbours above and below is `above` / unit and `below` / unit. */
struct shortest {
	struct large rest, unit, above, below;
	bool ends_count; /* reading rounds what is exactly half way to this value */
};

static struct shortest decimal_begin(uint32_t fraction, int exponent)
{
	/* Below a power of two floats stand twice as close. */
	const bool uneven = fraction == HIDDEN_BIT && exponent > EXPONENT_LEAST;
	const int up = exponent > 0 ? exponent : 0, down = exponent < 0 ? -exponent : 0;
	struct shortest s = {
		.rest = decimal_large(fraction),
		.unit = decimal_large(1),
		.above = decimal_large(1),
		.below = decimal_large(1),
		.ends_count = fraction % 2 == 0,
	};

	decimal_scale(&s.rest, 2, up + 1 + uneven);
	decimal_scale(&s.unit, 2, down + 1 + uneven);
	decimal_scale(&s.above, 2, up + uneven);
	decimal_scale(&s.below, 2, up);
	return s;
}

/* Does `sum`, of a number and its room above, reach the unit? */
static bool decimal_reaches(const struct shortest *s, const struct large *sum)
{
	const int order = decimal_compare(sum, &s->unit);

	return order > 0 || (order == 0 && s->ends_count);
}

/* Scales to 0.1 <= value + above < 1. Returns the power of ten that was divided by. */
static int decimal_scale_to_one(struct shortest *s)
{
	int power = 0;
	struct large sum = decimal_add(&s->rest, &s->above);

	while (decimal_reaches(s, &sum)) {
		decimal_multiply(&s->unit, 10, 0);
		++power;
	}
	for (;;) {
		decimal_multiply(&sum, 10, 0);
		if (decimal_reaches(s, &sum))
			return power;
		decimal_multiply(&s->rest, 10, 0);
		decimal_multiply(&s->above, 10, 0);
		decimal_multiply(&s->below, 10, 0);
		--power;
	}
}

/* Takes the next digit. */
static char decimal_digit(struct shortest *s)
{
	char digit = '0';

	decimal_multiply(&s->rest, 10, 0);
	decimal_multiply(&s->above, 10, 0);
	decimal_multiply(&s->below, 10, 0);
	for (; decimal_compare(&s->rest, &s->unit) >= 0; ++digit)
		decimal_subtract(&s->rest, &s->unit);
	return digit;
}

/* Writes the digits behind "0."; returns how many. The value is that times ten to *power. */
static unsigned decimal_digits(uint32_t fraction, int exponent, char digits[SHORTEST_DIGITS], int *power)
{
	struct shortest s = decimal_begin(fraction, exponent);
	unsigned count = 0;

	*power = decimal_scale_to_one(&s);
	for (;;) {
		const char digit = decimal_digit(&s);
		const int order = decimal_compare(&s.rest, &s.below);
		const struct large sum = decimal_add(&s.rest, &s.above);
		const bool low = order < 0 || (order == 0 && s.ends_count), high = decimal_reaches(&s, &sum);
		const bool last = low || high || count + 1 == SHORTEST_DIGITS;
		const struct large twice = decimal_add(&s.rest, &s.rest);
		const int half = decimal_compare(&twice, &s.unit); /* of two that are as near, the even digit */
		const bool up = low != high ? high : half > 0 || (half == 0 && digit % 2 != 0);
		digits[count++] = (char)(digit + (last && up));
		if (last)
			return count;
	}
}

static size_t decimal_put_exponent(int exponent, char *text)
{
	const unsigned size = (unsigned)(exponent < 0 ? -exponent : exponent);
	size_t n = 0;

	text[n++] = 'e';
	if (exponent < 0)
		text[n++] = '-';
	if (size >= 10)
		text[n++] = (char)('0' + size / 10);
	text[n++] = (char)('0' + size % 10);
	return n;
}

/* The digits with their point at `point`, which may lie before or behind them. */
static size_t decimal_put_digits(const char *digits, unsigned count, int point, char *text)
{
	const int end = point > (int)count ? point : (int)count;
	size_t n = 0;

	for (int i = point > 0 ? 0 : point - 1; i < end; ++i) {
		if (i == point)
			text[n++] = '.';
		text[n++] = i >= 0 && i < (int)count ? digits[i] : '0';
	}
	return n;
}

size_t decimal_format(float value, char text[DECIMAL_BYTES])
{
	uint32_t bits;
	char digits[SHORTEST_DIGITS];
	int power;
	size_t n = 0;

	memcpy(&bits, &value, sizeof bits);
	if (bits & SIGN_BIT)
		text[n++] = '-';
	bits &= ~SIGN_BIT;
	if (bits >= INFINITE_BITS || bits == 0) {
		memcpy(text + n, bits == 0 ? "0\0\0" : bits == INFINITE_BITS ? "inf" : "nan", 4);
		return n + (bits == 0 ? 1 : 3);
	}
	const bool normal = bits >= HIDDEN_BIT;
	const uint32_t fraction = normal ? (bits & (HIDDEN_BIT - 1)) | HIDDEN_BIT : bits;
	const int exponent = normal ? (int)(bits >> FRACTION_BITS) - 1 + EXPONENT_LEAST : EXPONENT_LEAST;
	const unsigned count = decimal_digits(fraction, exponent, digits, &power);
	const bool plain = power >= PLAIN_LEAST && power <= PLAIN_MOST;
	n += decimal_put_digits(digits, count, plain ? power : 1, text + n);
	if (!plain)
		n += decimal_put_exponent(power - 1, text + n);
	text[n] = '\0';
	return n;
}

/* --- From text ------------------------------------------------------------------------------------------------ */
/* digits * 10^power. */
struct decimal {
	bool negative;
	struct large digits;
	int count; /* of digits, without zeros before them */
	int power;
};

static bool decimal_is_digit(char c)
{
	return c >= '0' && c <= '9';
}

/* Reads digits with or without a point among them. Returns where they end; NULL: there are none, or too many. */
static const char *decimal_read_digits(const char *text, struct decimal *decimal)
{
	bool any = false, behind = false;

	for (; decimal_is_digit(*text) || (*text == '.' && !behind); ++text) {
		if (*text == '.') {
			behind = true;
			continue;
		}
		any = true;
		decimal->power -= behind;
		if (decimal->count == 0 && *text == '0')
			continue;
		if (++decimal->count > DECIMAL_DIGITS_MAX)
			return NULL;
		decimal_multiply(&decimal->digits, 10, (uint32_t)(*text - '0'));
	}
	return any ? text : NULL;
}

/* Reads an exponent, if there is one. Returns where it ends, NULL: it has no digits. */
static const char *decimal_read_exponent(const char *text, struct decimal *decimal)
{
	if (*text != 'e' && *text != 'E')
		return text;
	const char sign = *++text;
	int exponent = 0;
	text += sign == '-' || sign == '+';
	if (!decimal_is_digit(*text))
		return NULL;
	for (; decimal_is_digit(*text); ++text)
		if (exponent < EXPONENT_SEEN_MAX)
			exponent = exponent * 10 + (*text - '0');
	decimal->power += sign == '-' ? -exponent : exponent;
	return text;
}

/* The bits of the float nearest to number / unit, both above 0. */
static uint32_t decimal_round(struct large number, struct large unit)
{
	int exponent = -(FRACTION_BITS + 1);
	uint32_t fraction = 0;

	/* number / unit comes within [1/2, 1), unless the float is so small that it lacks bits. With FRACTION_BITS + 1
	 * bits of it taken, the last one weighs 2^exponent. */
	for (; decimal_compare(&number, &unit) >= 0; ++exponent)
		decimal_multiply(&unit, 2, 0);
	for (;; --exponent) {
		const struct large twice = decimal_add(&number, &number);
		if (exponent <= EXPONENT_LEAST || decimal_compare(&twice, &unit) >= 0)
			break;
		number = twice;
	}
	for (unsigned i = 0; i <= FRACTION_BITS; ++i) {
		decimal_multiply(&number, 2, 0);
		const bool bit = decimal_compare(&number, &unit) >= 0;
		if (bit)
			decimal_subtract(&number, &unit);
		fraction = fraction << 1 | bit;
	}
	const struct large twice = decimal_add(&number, &number);
	const int order = decimal_compare(&twice, &unit);
	fraction += order > 0 || (order == 0 && fraction % 2 == 1);
	/* The hidden bit, and a carry into it, count the exponent up by one. */
	const uint32_t bits = ((uint32_t)(exponent - EXPONENT_LEAST) << FRACTION_BITS) + fraction;
	return bits < INFINITE_BITS && exponent <= EXPONENT_MOST ? bits : INFINITE_BITS;
}

static uint32_t decimal_bits(struct decimal decimal)
{
	struct large unit = decimal_large(1);

	if (decimal.count == 0 || decimal.count + decimal.power < DECIMAL_LEAST)
		return 0;
	if (decimal.count + decimal.power > DECIMAL_MOST)
		return INFINITE_BITS;
	decimal_scale(&decimal.digits, 10, decimal.power);
	decimal_scale(&unit, 10, -decimal.power);
	return decimal_round(decimal.digits, unit);
}

bool decimal_parse(const char *text, float *value)
{
	struct decimal decimal = { .negative = *text == '-' };

	text += *text == '-' || *text == '+';
	text = decimal_read_digits(text, &decimal);
	if (text)
		text = decimal_read_exponent(text, &decimal);
	if (!text || *text != '\0')
		return false;
	const uint32_t bits = decimal_bits(decimal) | (decimal.negative ? SIGN_BIT : 0);
	memcpy(value, &bits, sizeof bits);
	return true;
}
