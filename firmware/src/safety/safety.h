/* Safety: what the firmware is doing, and when the motors may turn. The one place that decides it. */
#pragma once

#include "nf_contract.h"

/* Conditions at one moment, in two words. A reason only forbids arming, except that RECEIVER_LOST and
 * GYRO_NOT_CALIBRATED also change the state; an input only changes the state. SWITCH_NOT_CYCLED and CRASHED are
 * computed by safety and ignored here. */
struct safety_conditions {
	uint32_t reasons; /* bit field of enum nf_arming_reason: SAFETY_REASON(name) */
	uint32_t inputs;  /* bit field of enum safety_input */
};
#define SAFETY_REASON(name) (1u << NF_ARMING_REASON_##name)

enum safety_input {
	SAFETY_SWITCH_ON = 1 << 0,
	SAFETY_OFF_HEARD = 1 << 1,      /* the last frame says off, whatever the link's state */
	SAFETY_RECEIVER_HELD = 1 << 2,  /* silent, but not yet lost */
	SAFETY_GYRO_INVALID = 1 << 3,   /* this, stuck and silent: with the reason GYRO_BAD */
	SAFETY_GYRO_STUCK = 1 << 4,
	SAFETY_GYRO_SATURATED = 1 << 5, /* for NF_GYRO_SATURATED_MS */
	SAFETY_GYRO_SILENT = 1 << 6,
	SAFETY_CRASH = 1 << 7,
	SAFETY_RUNAWAY = 1 << 8,
	SAFETY_NO_CONTROLLER = 1 << 9,
	SAFETY_INPUTS_END = 1 << 10,    /* above it are safety's own */
};

struct safety {
	enum nf_flight_state state;
	enum nf_stop_cause stop_cause; /* of the last stop */
	bool ready;                    /* at the last update the switch was off and the receiver heard */
	bool descends;                 /* a lost receiver means a descent, not a drop */
	uint32_t descent_steps;        /* control steps of a whole descent */
	uint32_t descent_left;         /* of the one under way; 0: there is none */
};

/* Starts in BOOT: a switch that is on at boot never arms. */
void safety_init(struct safety *safety, const struct nf_settings *settings, unsigned control_rate_hz);

/* Called for every receiver frame and every control step with all conditions that hold. Returns whether this update
 * armed. */
bool safety_update(struct safety *safety, struct safety_conditions conditions);

/* A control step has passed. */
void safety_tick(struct safety *safety);

/* May the motors turn? */
bool safety_motors(const struct safety *safety);

/* Is this a failsafe descent (rates centred, throttle of the setting)? Then the motors may turn. */
bool safety_descending(const struct safety *safety);

/* Those that hold, `reasons`, as shown to the pilot: with safety's own, and none at all while motors may turn. */
uint32_t safety_reasons(const struct safety *safety, uint32_t reasons);
