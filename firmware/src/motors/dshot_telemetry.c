#include "motors/dshot_telemetry.h"

#include <stdbool.h>

#include "nf_contract.h"

#define SAMPLES_A_BIT DSHOT_ANSWER_OVERSAMPLING
#define DATA_BITS (DSHOT_ANSWER_BITS - 1u)

/* Levels last one to three bits: so many samples at least, and at most. Whatever the phase of the samples and a clock that
 * is up to 11 % off, a bit is 2 to 4 of them, two are 5 to 7, three 8 to 10. */
#define RUN_MIN 2u
#define RUN_MAX 10u
static const uint8_t bits_of_run[RUN_MAX - RUN_MIN + 1u] = { 1, 1, 1, 2, 2, 2, 3, 3, 3 };

/* An edge that is moved by half a bit passes for another bit's, and a checksum of four bits lets some of that pass. So the
 * edges must also lie on a grid of bits as long as those of the answers before: without noise, samples see them late by
 * amounts that differ by less than one sample; some more is allowed. A bit too many or too few puts all behind it three
 * samples off. The length of a line's bits is learned from all answers whose checksum is right. */
#define FINE 256u /* parts of a sample */
#define PLACE (FINE / 4u)
#define PLACES 32u
#define PLACES_APART_MAX 6u
#define LEARNED_SHIFT 8 /* of a length, in parts of FINE's */
#define LEARNED(percent) ((int32_t)(SAMPLES_A_BIT * FINE << LEARNED_SHIFT) * (percent) / 100)
#define SHORTEST LEARNED(-7)
#define LONGEST LEARNED(10)

/* What is known of a line. `bits` is a one, which stands for the answer's begin, and behind it the bits up to the last
 * change: where they have become more than 32, the highest one is among the last three, as no two changes are further
 * apart. */
#define TOO_MANY (1u << (DSHOT_ANSWER_BITS + 1u))
struct line {
	uint32_t bits; /* 0: nothing has come */
	uint32_t last; /* change, as a sample's number */
	uint32_t late; /* that change, against the grid [1/FINE sample], and ON_TIME beside */
	uint32_t places; /* bit field: how late all of them were, by PLACE */
};
#define ON_TIME (PLACES / 2u * PLACE)

/* The nibble that five bits stand for; NONE: they stand for none. A published code of limited run length. */
#define NONE 0x80u
// clang-format off
static const uint8_t nibbles[32] = {
	NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE, 0x9, 0xA, 0xB, NONE, 0xD, 0xE, 0xF,
	NONE, NONE, 0x2, 0x3, NONE, 0x5, 0x6, 0x7, NONE, 0x0, 0x8, 0x1, NONE, 0x4, 0xC, NONE,
};
// clang-format on

/* The word of 20 bits; their checksum makes the exclusive or of the four nibbles 15. */
static uint16_t dshot_telemetry_word(uint32_t data)
{
	const uint32_t a = nibbles[data >> 15 & 31u], b = nibbles[data >> 10 & 31u], c = nibbles[data >> 5 & 31u],
		       d = nibbles[data & 31u];

	if (((a | b | c | d) & NONE) != 0u || (a ^ b ^ c ^ d) != 0xFu)
		return NF_ESC_DAMAGED;
	return (uint16_t)(a << 8 | b << 4 | c);
}

/* The length of a bit [1/FINE sample]. */
static uint32_t dshot_telemetry_bit(int16_t learned)
{
	return SAMPLES_A_BIT * FINE + (uint32_t)(learned >> LEARNED_SHIFT);
}

/* `first`: the line's first change, if there is one. `rests`: it does at its first and at its last sample. The answer's last
 * change is a one's, or ends the last level where that is low; zeros at the end do not show. */
static __attribute__((noinline)) uint16_t dshot_telemetry_end(const struct line *line, uint32_t first, bool rests,
							      uint32_t count, uint32_t earliest, int16_t *learned)
{
	if (line->bits == 0u)
		return NF_ESC_SILENT;
	const uint32_t length = 31u - (uint32_t)__builtin_clz(line->bits); /* bits up to the last change */

	if (!rests || first < earliest || length > DSHOT_ANSWER_BITS || length < DATA_BITS - 1u ||
	    line->last + SAMPLES_A_BIT * (DSHOT_ANSWER_BITS + 1u - length) > count)
		return NF_ESC_DAMAGED;
	const uint16_t word = dshot_telemetry_word(line->bits << (DSHOT_ANSWER_BITS - length) >> 1);

	if (word == NF_ESC_DAMAGED)
		return word;
	const int32_t length_now = *learned +
				   (int32_t)(line->late -
					     ON_TIME); /* a thirteenth of what the last edge is off, about 20 bits on */

	*learned = (int16_t)(length_now < SHORTEST ? SHORTEST : length_now > LONGEST ? LONGEST : length_now);
	const uint32_t apart = 31u - (uint32_t)__builtin_clz(line->places) - (uint32_t)__builtin_ctz(line->places);

	return apart > PLACES_APART_MAX ? NF_ESC_DAMAGED : word;
}

void dshot_telemetry_decode(const uint32_t samples[], size_t pairs, uint32_t earliest, uint32_t lines,
			    int16_t learned[DSHOT_PORT_LINES], uint16_t words[DSHOT_PORT_LINES])
{
	struct line states[DSHOT_PORT_LINES];
	uint32_t firsts[DSHOT_PORT_LINES]; /* changes, where there are any */
	uint32_t watched = lines | lines << 16; /* a line on which noise is loses its place, and costs no more time */
	uint32_t same = (samples[0] & 0xFFFFu) * 0x10001u; /* the pair if no line changes */
	const uint32_t *pair = samples;
	const uint32_t count = 2u * (uint32_t)pairs;

	for (uint32_t left = lines; left != 0u; left &= left - 1u) {
		states[__builtin_ctz(left)] = (struct line){ .last = 0u - RUN_MAX - 1u };
		firsts[__builtin_ctz(left)] = 0;
	}
	for (uint32_t begin = 0; begin < count; begin += 2u) {
		const uint32_t now = *pair++;

		if (((now ^ same) & watched) == 0u)
			continue;
		uint32_t changes = (now ^ (now << 16 | (same & 0xFFFFu))) & watched;

		same = (now >> 16) | (now & 0xFFFF0000u);
		do { /* the earlier sample's first */
			const uint32_t change = (uint32_t)__builtin_ctz(changes), number = change % DSHOT_PORT_LINES;
			struct line *const line = &states[number];
			const uint32_t at = begin + change / DSHOT_PORT_LINES, run = at - line->last - RUN_MIN;

			changes &= changes - 1u;
			if (run <= RUN_MAX - RUN_MIN) {
				const uint32_t bits = bits_of_run[run];

				line->bits = line->bits << bits | 1u;
				line->late += (run + RUN_MIN) * FINE - bits * dshot_telemetry_bit(learned[number]);
				line->places |= 1u << line->late / PLACE % PLACES;
				line->last = at;
			} else if (line->bits == 0u) {
				*line = (struct line){ 1, at, ON_TIME, 1u << ON_TIME / PLACE };
				firsts[number] = at;
			} else {
				line->bits = TOO_MANY;
				watched &= ~(0x10001u << number);
				changes &= watched;
			}
		} while (changes != 0u);
	}
	const uint32_t rest = samples[0] & same;

	for (uint32_t left = lines; left != 0u; left &= left - 1u) {
		const uint32_t line = (uint32_t)__builtin_ctz(left);

		words[line] = dshot_telemetry_end(&states[line], firsts[line], (rest >> line & 1u) != 0u, count,
						  earliest, &learned[line]);
	}
}
