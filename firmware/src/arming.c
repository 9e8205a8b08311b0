#include "arming.h"

#include <stddef.h>

#define REASON(name) (1u << NF_ARMING_REASON_##name)
#define SWITCH_ON (1u << 31)
#define FORBIDS_ARMING \
	(REASON(BOOT_GRACE) | REASON(GYRO_NOT_CALIBRATED) | REASON(RECEIVER_LOST) | REASON(THROTTLE_HIGH) | \
	 REASON(POLICY_BAD))
#define DISARMS (REASON(RECEIVER_LOST) | REASON(POLICY_BAD))

/* The first row that fits moves the state; none leaves it. A row fits when all bits of `all`, at least one
 * of `any` (unless that is 0) and none of `none` hold.
 *
 * Losing the receiver locks, armed or not: a switch found on when it returns was not moved by a pilot who
 * had the aircraft. A switch moved on while something forbids arming locks too: the aircraft must not arm
 * by itself when the reason goes away. */
static const struct transition {
	enum arming_state from;
	uint32_t all, any, none;
	enum arming_state to;
} transitions[] = {
	{ ARMING_ARMED, 0, DISARMS, 0, ARMING_LOCKED },
	{ ARMING_ARMED, 0, 0, SWITCH_ON, ARMING_READY },
	{ ARMING_READY, REASON(RECEIVER_LOST), 0, 0, ARMING_LOCKED },
	{ ARMING_READY, SWITCH_ON, FORBIDS_ARMING, 0, ARMING_LOCKED },
	{ ARMING_READY, SWITCH_ON, 0, 0, ARMING_ARMED },
	{ ARMING_LOCKED, 0, 0, SWITCH_ON | REASON(RECEIVER_LOST), ARMING_READY },
};

void arming_init(struct arming *arming)
{
	arming->state = ARMING_LOCKED;
}

static enum arming_state next(enum arming_state state, uint32_t conditions)
{
	for (size_t i = 0; i < sizeof transitions / sizeof transitions[0]; i++) {
		const struct transition *t = &transitions[i];
		if (t->from == state && (conditions & t->all) == t->all &&
		    (t->any == 0 || (conditions & t->any) != 0) && (conditions & t->none) == 0)
			return t->to;
	}
	return state;
}

bool arming_step(struct arming *arming, uint32_t reasons, bool switch_on)
{
	const enum arming_state before = arming->state;

	arming->state = next(before, reasons | (switch_on ? SWITCH_ON : 0u));
	return before != ARMING_ARMED && arming->state == ARMING_ARMED;
}

bool arming_is_armed(const struct arming *arming)
{
	return arming->state == ARMING_ARMED;
}

uint32_t arming_reasons(const struct arming *arming, uint32_t reasons)
{
	switch (arming->state) {
	case ARMING_ARMED:
		return 0;
	case ARMING_READY:
		return reasons;
	default:
		return reasons | REASON(SWITCH_NOT_CYCLED);
	}
}
