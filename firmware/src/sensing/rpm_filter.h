/* Notches on the rotors' vibration: at the turns of each motor that its ESC tells, and at their multiples, the same on each axis.
 * They need no search as dynamic_notch.h's do, and follow a rotor within milliseconds.
 *
 * Every gyro sample moves the notches of one motor, the next one in turn: with the four of a quadcopter at 4 kHz each is moved
 * once a control step. A notch fades out towards its lowest centre, and where a motor's ESC is silent it is gone. */
#pragma once

#include "nf_contract.h"
#include "policy.h"
#include "sensing/rotors.h"
#include "sensing/svf.h"

#define RPM_HARMONICS_MAX 3 /* the setting's limit */

struct rpm_notch {
	struct svf svf;
	float depth; /* of the quality's damping what is taken out; 0: nothing */
	struct svf_memory memory[3];
};

struct rpm_filter {
	uint8_t harmonics; /* notches a motor and axis, 0: off */
	uint8_t next; /* motor whose notches are moved next */
	float damping; /* 1 / Q */
	float turns; /* a sample for a rad/s */
	float least, fade; /* turns a sample: the lowest centre; 1 over the width above it in which a notch fades in */
	float least_gain; /* tan of the lowest centre */
	struct rpm_notch notch[POLICY_ACTION_COUNT][RPM_HARMONICS_MAX];
};

/* From the settings rpm_filter_*; off where the ESCs are not asked. */
void rpm_filter_init(struct rpm_filter *filter, const struct nf_settings *settings, unsigned gyro_rate_hz);

/* One gyro sample, in place [rad/s]. Off, not a bit changes. */
void rpm_filter_step(struct rpm_filter *filter, const struct rotors *rotors, float rate[3]);
