#include "motors/dshot_telemetry.h"

#include <stdbool.h>

#include "nf_contract.h"

#define SAMPLES_A_BIT DSHOT_ANSWER_OVERSAMPLING
#define DATA_BITS (DSHOT_ANSWER_BITS - 1u)
/* Levels last one to three bits. Whatever the phase of the samples and a clock that is up to 11 % off, that is 2 to 4,
 * 5 to 7 or 8 to 10 samples. */
#define RUN_MIN 2u
#define RUN_MAX 10u
#define DRIFT_MAX 5 /* samples, of 63: 8 % */

/* What is known of a line. `bits` is a one, which stands for the answer's begin, and behind it the bits up to the last
 * change. With TOO_MANY or more it is no answer any more. */
#define TOO_MANY (1u << (DSHOT_ANSWER_BITS + 1u))
struct line {
	uint32_t bits;  /* 0: nothing has come */
	uint16_t first; /* change, as a sample's number */
	uint16_t last;
};

/* The nibble that five bits stand for; NONE: they stand for none. A published code of limited run length. */
#define NONE 0x80u
// clang-format off
static const uint8_t nibbles[32] = {
	NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE, 0x9, 0xA, 0xB, NONE, 0xD, 0xE, 0xF,
	NONE, NONE, 0x2, 0x3, NONE, 0x5, 0x6, 0x7, NONE, 0x0, 0x8, 0x1, NONE, 0x4, 0xC, NONE,
};
// clang-format on

/* The line has changed at sample `at`. Returns whether it may still be an answer. */
static inline __attribute__((always_inline)) bool dshot_telemetry_change(struct line *line, uint32_t at)
{
	const uint32_t run = at - line->last;

	line->last = (uint16_t)at;
	if (line->bits == 0u) {
		line->first = (uint16_t)at;
		line->bits = 1;
		return true;
	}
	line->bits = run - RUN_MIN <= RUN_MAX - RUN_MIN ? line->bits << (run + 1u) / SAMPLES_A_BIT | 1u : TOO_MANY;
	return line->bits < TOO_MANY;
}

/* The word of 20 bits; their checksum makes the exclusive or of the four nibbles 15. */
static uint16_t dshot_telemetry_word(uint32_t data)
{
	const uint32_t a = nibbles[data >> 15 & 31u], b = nibbles[data >> 10 & 31u], c = nibbles[data >> 5 & 31u],
		       d = nibbles[data & 31u];

	if (((a | b | c | d) & NONE) != 0u || (a ^ b ^ c ^ d) != 0xFu)
		return NF_ESC_DAMAGED;
	return (uint16_t)(a << 8 | b << 4 | c);
}

/* `rests`: the line does at its first and at its last sample. The answer's last change is a one's, or ends the last level
 * where that is low; zeros at the end do not show. */
static uint16_t dshot_telemetry_end(const struct line *line, bool rests, uint32_t count, uint32_t earliest)
{
	if (line->bits == 0u)
		return NF_ESC_SILENT;
	const uint32_t length = 31u - (uint32_t)__builtin_clz(line->bits); /* bits up to the last change */
	const int32_t drift = line->last - line->first - (int32_t)(SAMPLES_A_BIT * length);

	if (!rests || line->first < earliest || length > DSHOT_ANSWER_BITS || length < DATA_BITS - 1u ||
	    drift > DRIFT_MAX || drift < -DRIFT_MAX ||
	    line->first + drift + (int32_t)(SAMPLES_A_BIT * (DSHOT_ANSWER_BITS + 1u)) > (int32_t)count)
		return NF_ESC_DAMAGED;
	return dshot_telemetry_word(line->bits << (DSHOT_ANSWER_BITS - length) >> 1);
}

void dshot_telemetry_decode(const uint32_t samples[], size_t pairs, uint32_t earliest, uint32_t lines,
			    uint16_t words[DSHOT_PORT_LINES])
{
	struct line states[DSHOT_PORT_LINES];
	uint32_t watched = lines | lines << 16; /* a line on which noise is loses its place, and costs no more time */
	uint32_t before = samples[0] << 16; /* the sample before the pair is in its upper half */

	for (uint32_t left = lines; left != 0u; left &= left - 1u)
		states[__builtin_ctz(left)] = (struct line){ 0 };
	for (uint32_t i = 0; i < pairs; ++i) {
		const uint32_t now = samples[i];
		uint32_t changes = (now ^ (now << 16 | before >> 16)) & watched;

		before = now;
		for (; changes != 0u; changes &= (changes - 1u) & watched) { /* the earlier sample's first */
			const uint32_t change = (uint32_t)__builtin_ctz(changes), line = change % DSHOT_PORT_LINES;

			if (!dshot_telemetry_change(&states[line], 2u * i + change / DSHOT_PORT_LINES))
				watched &= ~(0x10001u << line);
		}
	}
	const uint32_t rest = samples[0] & before >> 16;

	for (uint32_t left = lines; left != 0u; left &= left - 1u) {
		const uint32_t line = (uint32_t)__builtin_ctz(left);

		words[line] = dshot_telemetry_end(&states[line], (rest >> line & 1u) != 0u, 2u * (uint32_t)pairs,
						  earliest);
	}
}
