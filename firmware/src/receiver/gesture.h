/* Gesture: the sticks by which a pilot in the field says "I know": both down and apart (mode 2), that is throttle low,
 * yaw full left, pitch full back, roll full right. It does not arm anything here or in Betaflight. */
#pragma once

#include "nf_contract.h"

struct gesture {
	bool shown;        /* at the last step */
	bool told;         /* for as long as it is shown */
	uint32_t since_ms; /* shown */
};

void gesture_init(struct gesture *gesture);

/* Takes channels [us] as flown, at `ms` since any moment, wrapping. allowed: disarmed, with the arm switch off and a
 * good receiver; otherwise sticks are ignored. Returns true once, when the gesture has been held for NF_GESTURE_MS;
 * it must be released before it counts again. */
bool gesture_step(struct gesture *gesture, const uint16_t channels_us[NF_CHANNEL_COUNT], bool allowed, uint32_t ms);
