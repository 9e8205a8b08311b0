#include "common/nf_math.h"

#include "common/limit.h"

#define EIGHTH 0.125f
#define QUARTER 0.25f
#define HALF 0.5f

/* Taylor series, the terms beyond are below 1e-8 of the result up to an eighth of a turn. */
static float nf_sin_eighth(float turns)
{
	const float x = NF_TAU * turns;
	const float x2 = x * x;

	return x * (1.0f + x2 * (-1.0f / 6 + x2 * (1.0f / 120 + x2 * (-1.0f / 5040 + x2 * (1.0f / 362880)))));
}

static float nf_cos_eighth(float turns)
{
	const float x = NF_TAU * turns;
	const float x2 = x * x;

	return 1.0f + x2 * (-1.0f / 2 + x2 * (1.0f / 24 + x2 * (-1.0f / 720 + x2 * (1.0f / 40320))));
}

/* Sine and cosine up to a quarter of a turn. The subtractions from a quarter or a half are exact, because the two numbers
 * are within a factor of two of each other (Sterbenz), so small results keep all their digits. */
static float nf_sin_quarter(float turns)
{
	return turns <= EIGHTH ? nf_sin_eighth(turns) : nf_cos_eighth(QUARTER - turns);
}

static float nf_cos_quarter(float turns)
{
	return turns <= EIGHTH ? nf_cos_eighth(turns) : nf_sin_eighth(QUARTER - turns);
}

float nf_sin_turns(float turns)
{
	return turns <= QUARTER ? nf_sin_quarter(turns) : nf_sin_quarter(HALF - turns);
}

float nf_cos_turns(float turns)
{
	return turns <= QUARTER ? nf_cos_quarter(turns) : -nf_cos_quarter(HALF - turns);
}

#define EXP_ALL 20.0f     /* from here on 1 - exp(-x) is 1 in float32 */
#define EXP_SERIES 0.125f /* up to here five terms are enough */

float nf_one_minus_exp(float x)
{
	float part = limit(x, 0.0f, EXP_ALL);
	int doublings = 0;

	while (part > EXP_SERIES) {
		part *= 0.5f;
		++doublings;
	}
	float gain = part * (1.0f - part * (1.0f / 2 - part * (1.0f / 6 - part * (1.0f / 24 - part * (1.0f / 120)))));
	while (doublings-- > 0)
		gain *= 2.0f - gain; /* 1 - e^-2x = (1 - e^-x) (2 - (1 - e^-x)) */
	return gain;
}

#define LOG_LEAST 1e-6f
#define LOG_MOST 1e6f
#define LN_2 0.693147180559945309f
#define ROOT_2 1.41421356237309505f

float nf_log(float x)
{
	float part = limit(x, LOG_LEAST, LOG_MOST);
	float doublings = 0.0f;

	for (; part > ROOT_2; part *= 0.5f)
		doublings += 1.0f;
	for (; part < ROOT_2 / 2; part *= 2.0f)
		doublings -= 1.0f;
	/* ln x = 2 artanh z; z is at most 0.172, the term beyond 2 z^9 / 9 = 3e-8. */
	const float z = (part - 1.0f) / (part + 1.0f);
	const float z2 = z * z;
	const float rest = 2.0f * z * (1.0f + z2 * (1.0f / 3 + z2 * (1.0f / 5 + z2 * (1.0f / 7))));

	return doublings * LN_2 + rest;
}

#define TAN_EIGHTH_PI 0.414213562373095f
#define QUARTER_PI (NF_PI / 4)
#define HALF_PI (NF_PI / 2)

/* Up to tan(pi/8); odd Taylor series, the term beyond is 0.4142^15 / 15 = 1.2e-7 of a radian. */
static float nf_atan_small(float t)
{
	const float t2 = t * t;

	return t * (1.0f +
		    t2 * (-1.0f / 3 +
			  t2 * (1.0f / 5 + t2 * (-1.0f / 7 + t2 * (1.0f / 9 + t2 * (-1.0f / 11 + t2 * (1.0f / 13)))))));
}

float nf_atan2(float y, float x)
{
	const float high = y < 0.0f ? -y : y;
	const float wide = x < 0.0f ? -x : x;
	const float small = high < wide ? high : wide;
	const float large = high < wide ? wide : high;

	if (!(large > 0.0f))
		return 0.0f;
	const float ratio = small / large; /* 0..1 */
	float angle = ratio > TAN_EIGHTH_PI ? QUARTER_PI + nf_atan_small((ratio - 1.0f) / (ratio + 1.0f)) :
					      nf_atan_small(ratio);
	if (high > wide)
		angle = HALF_PI - angle;
	if (x < 0.0f)
		angle = NF_PI - angle;
	return y < 0.0f ? -angle : angle;
}

float nf_asin(float x)
{
	const float sine = limit(x, -1.0f, 1.0f);

	return nf_atan2(sine, __builtin_sqrtf((1.0f - sine) * (1.0f + sine)));
}
