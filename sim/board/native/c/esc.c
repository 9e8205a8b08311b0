/* The ESCs on the motors' lines: DShot frames out of trains of pulses (sim/board/devices/esc.py says what a frame is). */
#include "peripherals.h"

enum { GAP = 432 }; /* least rest before a frame: 2 us [cycles] */

/* Takes a train for a DShot frame; false: it is none, or Python has to say what is wrong with it. */
static bool esc_take(struct native *n, uint32_t t, uint32_t channel, const struct train *train)
{
	struct esc *const esc = &n->s.timers[t].escs[channel];
	const uint64_t length = train->length;
	uint32_t frame = 0;

	if (length < esc->shortest || length > esc->longest || (int64_t)train->start < esc->rest_since + GAP)
		return false;
	for (uint32_t i = 0; i < TRAIN; ++i) {
		/* 37.5 % of the bit for a 0, 75 % for a 1, within 5 % of that: sim/board/devices/esc.py. */
		const uint64_t high = 8u * (uint64_t)train->highs[i];
		const uint64_t nominal = 16u * (uint64_t)train->highs[i] > 9u * length ? 6u * length : 3u * length;

		if (20u * (high > nominal ? high - nominal : nominal - high) > nominal)
			return false;
		frame = frame << 1 | (nominal == 6u * length);
	}
	const uint32_t data = frame >> 4;

	if ((frame & 15u) != ((data ^ data >> 4 ^ data >> 8) & 15u))
		return false;
	if (n->s.frame_count == FRAMES)
		native_tell_frames(n);
	esc->last_cycle = train->start + TRAIN * length;
	esc->rest_since = (int64_t)esc->last_cycle;
	esc->last = data;
	++esc->frames;
	if (n->frames_heard)
		n->s.frames[n->s.frame_count++] =
			(struct frame){.cycle = esc->last_cycle, .motor = esc->motor, .data = data};
	return true;
}

void esc_show(struct native *n, uint32_t t, uint32_t channel, uint64_t start, uint64_t length, uint32_t high)
{
	struct train *const train = &n->s.timers[t].trains[channel];

	if (train->count != 0u && (train->length != length || train->start + train->count * length != start)) {
		n->callbacks.pulses(n->devices[TIMER][t], channel + 1u, train->start, train->length, train->count, train->highs);
		train->count = 0;
	}
	if (train->count == 0u) {
		if (high == 0u)
			return;
		train->start = start;
		train->length = length;
	}
	train->highs[train->count++] = high;
	if (high == 0u || train->count == TRAIN) {
		if (high == 0u || !esc_take(n, t, channel, train))
			n->callbacks.pulses(n->devices[TIMER][t], channel + 1u, train->start, length, train->count, train->highs);
		train->count = 0;
	}
}

struct esc *native_esc(struct native *n, uint32_t motor, uint32_t t, uint32_t channel)
{
	struct esc *const esc = &n->s.timers[t].escs[channel - 1u];

	esc->motor = motor;
	esc->last = NO_FRAME;
	n->motors[motor] = esc;
	return esc;
}

bool native_obeyed(const struct native *n, uint32_t count, uint64_t silent, uint16_t *values)
{
	const uint64_t cycle = native_now(n);
	bool changed = false;

	for (uint32_t i = 0; i < count; ++i) {
		const struct esc *const esc = n->motors[i];
		const bool hears = esc->last != NO_FRAME && (cycle <= esc->last_cycle || cycle - esc->last_cycle <= silent);
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
