/* The lines of a port under any levels. Input: the lines that are decoded (two bytes), the sample before which no answer
 * begins (one), then the samples, two bytes each. */
#include "fuzz.h"

#include "motors/dshot_telemetry.h"
#include "nf_contract.h"

#define UNTOUCHED 0x5A5Au
#define CHANGES_MAX 22u /* of an answer: its begin, 20 ones, its end */

/* What is told of a line is what its levels allow. */
static void look(const uint16_t *samples, size_t count, unsigned line, uint16_t word)
{
	unsigned changes = 0;

	for (size_t i = 1; i < count; ++i)
		changes += (samples[i] ^ samples[i - 1]) >> line & 1u;
	PROMISE(word == NF_ESC_SILENT || word == NF_ESC_DAMAGED || word <= NF_ESC_WORD_MAX);
	PROMISE((word == NF_ESC_SILENT) == (changes == 0));
	if (word <= NF_ESC_WORD_MAX) {
		PROMISE((samples[0] >> line & 1u) == 1 && (samples[count - 1] >> line & 1u) == 1);
		PROMISE(changes % 2 == 0 && changes <= CHANGES_MAX && count >= DSHOT_ANSWER_SAMPLES - 10);
	}
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input input = { data, size };
	const unsigned low = input_byte(&input), lines = low | input_byte(&input) << 8, earliest = input_byte(&input);
	size_t bytes = input.left / 4 * 4;
	uint16_t words[DSHOT_PORT_LINES], alone[DSHOT_PORT_LINES];
	int16_t learned[DSHOT_PORT_LINES] = { 0 }, before[DSHOT_PORT_LINES] = { 0 };

	if (bytes == 0 || bytes > 4 * 0x7FFF)
		return 0;
	uint8_t *const samples = input_bytes(&input, &bytes);
	for (unsigned line = 0; line < DSHOT_PORT_LINES; ++line)
		words[line] = alone[line] = UNTOUCHED;
	dshot_telemetry_decode((const uint32_t *)(void *)samples, bytes / 4, earliest, lines, learned, words);
	for (unsigned line = 0; line < DSHOT_PORT_LINES; ++line) {
		if ((lines >> line & 1u) == 0) {
			PROMISE(words[line] == UNTOUCHED);
			continue;
		}
		look((const uint16_t *)(void *)samples, bytes / 2, line, words[line]);
		dshot_telemetry_decode((const uint32_t *)(void *)samples, bytes / 4, earliest, 1u << line, before, alone);
		PROMISE(alone[line] == words[line] && before[line] == learned[line]); /* the others make no difference */
	}
	free(samples);
	return 0;
}
