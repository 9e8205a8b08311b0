/* The ESCs on the motors' lines: DShot frames out of edges, and their answers (sim/board/devices/esc.py says what a frame
 * is and what its limits are). */
#include "peripherals.h"

enum {
	BITS = 16,
	SPACES = BITS - 1, /* between begins of bits */
	GAP_BITS = 2,      /* least rest before a frame */
	LONG = 14400,      /* ten bits of the slowest protocol: the line has come to rest at this level [cycles] */
	PAUSE = 2160,      /* one and a half of its bits */
};
/* Shares of a bit [1/1000] that a pulse may take: sim/board/devices/esc.py. */
enum { ZERO_MIN = 317, ZERO_MAX = 384, ONE_MIN = 633, ONE_MAX = 788, UNEVEN = 50 };

enum { ANSWER_BITS = 21 };
/* Extended telemetry begins when it is asked for so often in a row, with an answer that says so; then each so manieth answer is
 * of it. */
enum { COMMAND_ON = 13, COMMAND_OFF = 14, TIMES = 6, BEGINS = 0xE00, EVERY = 41 };

/* ---- frames ---- */

static bool esc_decode(const struct esc *esc, uint32_t *data, uint64_t *end)
{
	const uint64_t *const at = esc->edges;
	const uint64_t span = at[ESC_EDGES - 2] - at[0], length = (span + SPACES / 2) / SPACES;
	uint32_t frame = 0;

	if (length < esc->shortest || length > esc->longest || esc->rest != esc->inverted ||
	    (int64_t)at[0] < esc->rest_since + (int64_t)(GAP_BITS * length))
		return false;
	for (uint32_t i = 0; i < BITS; ++i) {
		const uint64_t begin = SPACES * (at[2u * i] - at[0]), even = i * span;
		const uint64_t share = 1000u * SPACES * (at[2u * i + 1u] - at[2u * i]) / span;
		const bool one = share >= ONE_MIN;

		if (1000u * (begin > even ? begin - even : even - begin) > UNEVEN * span)
			return false;
		if (share < ZERO_MIN || share > ONE_MAX || (!one && share > ZERO_MAX))
			return false;
		frame = frame << 1 | one;
	}
	*data = frame >> 4;
	*end = at[ESC_EDGES - 2] + length;
	return (frame & 15u) == ((*data ^ *data >> 4 ^ *data >> 8 ^ (esc->inverted ? 15u : 0u)) & 15u);
}

/* ---- answers ---- */

/* A number of 32 bits (xorshift64*). */
static uint32_t esc_random(struct esc *esc)
{
	esc->random ^= esc->random >> 12;
	esc->random ^= esc->random << 25;
	esc->random ^= esc->random >> 27;
	return (uint32_t)(esc->random * UINT64_C(0x2545F4914F6CDD1D) >> 32);
}

static bool esc_happens(struct esc *esc, double share)
{
	return share > 0.0 && esc_random(esc) < share * 4294967296.0;
}

/* The word with its checksum, five bits a nibble: no more than three equal ones follow each other on the line. */
static uint32_t esc_coded(uint32_t word)
{
	static const uint8_t codes[] = {0x19, 0x1B, 0x12, 0x13, 0x1D, 0x15, 0x16, 0x17, 0x1A, 0x09, 0x0A, 0x0B, 0x1E, 0x0D, 0x0E, 0x0F};
	const uint32_t all = word << 4 | (~(word ^ word >> 4 ^ word >> 8) & 15u);

	return (uint32_t)codes[all >> 12 & 15u] << 15 | (uint32_t)codes[all >> 8 & 15u] << 10 |
	       (uint32_t)codes[all >> 4 & 15u] << 5 | codes[all & 15u];
}

static void esc_toggle(struct esc *esc, double cycle)
{
	const int64_t late = esc->jitter ? (int64_t)(esc_random(esc) % (2u * esc->jitter + 1u)) - (int64_t)esc->jitter : 0;

	esc->answer_edges[esc->answer_edge_count++] = (uint64_t)((int64_t)(cycle + 0.5) + late);
}

/* A command counts while the motor stands, which no frame before it bids it to turn. */
static void esc_obey(struct esc *esc, uint32_t value)
{
	const bool on = value == COMMAND_ON;

	esc->asked = on || value == COMMAND_OFF ? (uint8_t)(esc->asked + 1u) : 0u;
	if (esc->asked != TIMES)
		return;
	esc->asked = 0;
	esc->extended = on;
	esc->others = EVERY - 1u;
	esc->kind = ESC_KINDS; /* that it begins */
}

/* The next answer. */
static uint32_t esc_word(struct esc *esc)
{
	if (!esc->extended || ++esc->others < EVERY)
		return esc->answer;
	esc->others = 0;
	if (esc->kind == ESC_KINDS) {
		esc->kind = 0;
		return BEGINS;
	}
	for (uint32_t i = 0; i < ESC_KINDS; ++i) {
		const uint32_t kind = esc->kind;

		esc->kind = (uint8_t)((kind + 1u) % ESC_KINDS);
		if (esc->kinds >> kind & 1u)
			return esc->told[kind];
	}
	return esc->answer;
}

/* The line falls; each one of the coded bits is a change; in the end it is let go. */
static void esc_reply(struct esc *esc)
{
	const double bit = esc->bit_factor * TIME_HZ / (1250.0 * esc->protocol);
	const double begin = (double)(esc->last_cycle + esc->delay);

	esc->answer_edge_count = 0;
	if (!esc->inverted || esc->answer == NO_ANSWER || esc_happens(esc, esc->silence))
		return;
	const uint32_t coded = esc_coded(esc_word(esc));

	++esc->answers;
	esc_toggle(esc, begin);
	for (uint32_t i = 1; i < ANSWER_BITS; ++i)
		if (coded >> (ANSWER_BITS - 1u - i) & 1u)
			esc_toggle(esc, begin + i * bit);
	esc->answer_end = (uint64_t)(begin + ANSWER_BITS * bit + 0.5);
	if (esc->answer_edge_count % 2u != 0u)
		esc->answer_edges[esc->answer_edge_count++] = esc->answer_end;
}

/* Fails if both drive the line. */
static void esc_validate(struct native *n, struct esc *esc)
{
	if (!esc->output || esc->answer_edge_count == 0u || esc->output_since >= esc->answer_end)
		return;
	const uint64_t begin = esc->answer_edges[0], both = esc->output_since > begin ? esc->output_since : begin;

	if (native_now(n) <= both)
		return;
	esc->answer_edge_count = 0;
	native_query(n, QUERY_DRIVEN, n->devices[PORT][esc->port], esc->pin, (uint32_t)(both - esc->last_cycle));
}

void esc_output(struct native *n, struct esc *esc, bool output)
{
	if (esc->output == output)
		return;
	esc_validate(n, esc);
	esc->output = output;
	esc->output_since = native_now(n);
}

bool esc_drives(const struct esc *esc, uint64_t cycle, bool *level)
{
	uint32_t passed = 0;

	if (esc->stuck != STUCK_NOT) {
		*level = esc->stuck == STUCK_HIGH;
		return true;
	}
	if (esc->answer_edge_count == 0u || cycle < esc->answer_edges[0] || cycle >= esc->answer_end)
		return false;
	while (passed < esc->answer_edge_count && esc->answer_edges[passed] <= cycle)
		++passed;
	*level = passed % 2u == 0u;
	return true;
}

void esc_sample(struct esc *esc, uint32_t bit, bool resting, uint32_t *items, uint32_t count, uint64_t start, uint64_t step)
{
	const uint32_t edges = esc->answer_edge_count;
	uint32_t passed = 0;

	for (uint32_t i = 0; i < count; ++i) {
		const uint64_t cycle = start + i * step;
		bool level = resting;

		while (passed < edges && esc->answer_edges[passed] <= cycle)
			++passed;
		if (esc->stuck != STUCK_NOT)
			level = esc->stuck == STUCK_HIGH;
		else if (passed != 0u && cycle < esc->answer_end)
			level = passed % 2u == 0u;
		if (esc_happens(esc, esc->noise))
			level = !level;
		items[i] |= level ? bit : 0u;
	}
}

/* ---- what it hears ---- */

static void esc_accept(struct native *n, struct esc *esc, uint64_t end, uint32_t data)
{
	if (n->s.frame_count == FRAMES)
		native_tell_frames(n);
	esc_validate(n, esc); /* the answer before this frame */
	esc->last_cycle = end;
	esc->rest_since = (int64_t)end;
	esc->last = data;
	++esc->frames;
	esc_obey(esc, data >> 1);
	if (n->frames_heard)
		n->s.frames[n->s.frame_count++] = (struct frame){.cycle = end, .motor = esc->motor, .data = data};
	esc_reply(esc);
}

void native_esc_accept(struct native *n, uint32_t motor, uint64_t end, uint32_t data)
{
	esc_accept(n, &n->s.escs[motor], end, data);
}

/* Hands over the edges of what is no plain frame, and forgets them. */
static void esc_tell(struct native *n, struct esc *esc)
{
	const uint32_t count = esc->edge_count;

	esc->edge_count = 0;
	n->callbacks.train(esc->motor, count, esc->edges, esc->rest);
}

/* Has a pulse of the frame under way begun too late for it? */
static bool esc_pauses(const struct esc *esc, uint64_t cycle)
{
	const uint64_t *const at = esc->edges;
	const uint32_t count = esc->edge_count;
	const uint64_t pause = count > 2u ? 3u * (at[2] - at[0]) / 2u : esc->longest != 0u ? 3u * esc->longest / 2u : PAUSE;

	return cycle - at[count - 2u] > pause;
}

void esc_edge(struct native *n, struct esc *esc, uint64_t cycle, bool level)
{
	if (esc->level == level)
		return;
	esc->level = level;
	if (esc->edge_count % 2u != 0u && cycle - esc->edges[esc->edge_count - 1u] > LONG) {
		if (esc->edge_count > 1u)
			esc_tell(n, esc);
		else
			esc->rest_since = (int64_t)esc->edges[0];
		esc->edge_count = 0;
	} else if (esc->edge_count != 0u && esc->edge_count % 2u == 0u && esc_pauses(esc, cycle)) {
		esc_tell(n, esc);
	}
	if (esc->edge_count == 0u)
		esc->rest = !level;
	esc->edges[esc->edge_count++] = cycle;
	if (esc->edge_count == ESC_EDGES) {
		uint64_t end;
		uint32_t data;

		if (esc_decode(esc, &data, &end)) {
			esc->edge_count = 0;
			esc_accept(n, esc, end, data);
		} else {
			esc_tell(n, esc);
		}
	}
}

/* ---- for Python ---- */

struct esc *native_esc(struct native *n, uint32_t motor, uint32_t port, uint32_t pin)
{
	struct esc *const esc = &n->s.escs[motor];

	esc->motor = motor;
	esc->port = (uint8_t)port;
	esc->pin = (uint8_t)pin;
	esc->last = NO_FRAME;
	esc->answer = NO_ANSWER;
	esc->bit_factor = 1.0;
	esc->random = motor + 1u;
	n->motor_pins[port] |= (uint16_t)(1u << pin);
	n->esc_of[port][pin] = (uint8_t)motor;
	n->motor_count = motor + 1u;
	return esc;
}

bool native_obeyed(const struct native *n, uint32_t count, uint64_t silent, uint16_t *values)
{
	const uint64_t cycle = native_now(n);
	bool changed = false;

	for (uint32_t i = 0; i < count; ++i) {
		const struct esc *const esc = &n->s.escs[i];
		const bool hears = i < n->motor_count && esc->last != NO_FRAME &&
				   (cycle <= esc->last_cycle || cycle - esc->last_cycle <= silent);
		const uint16_t value = hears ? (uint16_t)(esc->last >> 1) : 0u;

		changed |= values[i] != value;
		values[i] = value;
	}
	return changed;
}

void native_hear_frames(struct native *n)
{
	n->frames_heard = true;
}

void native_tell_frames(struct native *n)
{
	const uint32_t count = n->s.frame_count;

	n->s.frame_count = 0;
	if (count != 0u)
		n->callbacks.frames(n->s.frames, count);
}
