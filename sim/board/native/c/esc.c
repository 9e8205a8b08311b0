/* The ESCs on the motors' lines: DShot frames out of trains of pulses (sim/board/devices/esc.py says what a frame is). */
#include "esc.h"

enum { GAP = 432 }; /* least rest before a frame: 2 us [cycles] */

bool esc_take(struct native *h, uint32_t t, uint32_t channel, const struct train *train)
{
	struct esc *const esc = &h->s.timers[t].escs[channel];
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
	if (h->s.frame_count == FRAMES)
		native_tell_frames(h);
	esc->last_cycle = train->start + TRAIN * length;
	esc->rest_since = (int64_t)esc->last_cycle;
	esc->last = data;
	++esc->frames;
	if (h->frames_heard)
		h->s.frames[h->s.frame_count++] =
			(struct frame){.cycle = esc->last_cycle, .motor = esc->motor, .data = data};
	return true;
}

struct esc *native_esc(struct native *h, uint32_t motor, uint32_t t, uint32_t channel)
{
	struct esc *const esc = &h->s.timers[t].escs[channel - 1u];

	esc->motor = motor;
	esc->last = NO_FRAME;
	h->motors[motor] = esc;
	return esc;
}

void native_obeyed(const struct native *h, uint32_t count, uint64_t silent, uint16_t *values)
{
	const uint64_t cycle = native_now(h);

	for (uint32_t i = 0; i < count; ++i) {
		const struct esc *const esc = h->motors[i];
		const bool hears = esc->last != NO_FRAME && (cycle <= esc->last_cycle || cycle - esc->last_cycle <= silent);

		values[i] = hears ? (uint16_t)(esc->last >> 1) : 0u;
	}
}

void native_hear_frames(struct native *h)
{
	h->frames_heard = true;
}

void native_tell_frames(struct native *h)
{
	const uint32_t count = h->s.frame_count;

	h->s.frame_count = 0;
	if (count != 0u)
		h->callbacks.frames(h->s.frames, count);
}
