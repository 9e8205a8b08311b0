/* Weak motors: those that turn slower than the others for what they are given, as a worn bearing, a magnet that came loose, a wire
 * or an ESC makes them; or that stand. It is told, and changes nothing that is flown.
 *
 * Speeds and outputs are compared behind the same low-pass, so that nothing depends on how fast rotors follow. */
#pragma once

#include "nf_contract.h"
#include "policy.h"

struct weak_motor {
	uint8_t weak; /* bit field of motors; until the next flight */
	uint8_t next; /* motor that is looked at next */
	float smoothing; /* of the low-pass, in a control step */
	float best; /* rad/s for an output of 1: of the motor with the most, in the last round */
	float found; /* in this round */
	uint32_t patience; /* looks at a motor until it is weak */
	uint32_t looks[POLICY_ACTION_COUNT]; /* in a row, in which it was */
	float told[POLICY_ACTION_COUNT]; /* rad/s, behind the low-pass */
	float given[POLICY_ACTION_COUNT]; /* output, likewise */
};

void weak_motor_init(struct weak_motor *weak, unsigned control_rate_hz);

/* A flight begins. */
void weak_motor_reset(struct weak_motor *weak);

/* One control step in the air. speed: [rad/s]; silent: bit field of motors without one, which are not judged; output: 0..1. */
void weak_motor_step(struct weak_motor *weak, const float speed[POLICY_ACTION_COUNT], uint32_t silent,
		     const float output[POLICY_ACTION_COUNT]);
