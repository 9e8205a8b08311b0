/* Safety: what the firmware is doing, and when the motors may turn. The one place that decides it. */
#ifndef NF_SAFETY_H
#define NF_SAFETY_H

#include <stdbool.h>
#include <stdint.h>

#include "nf_contract.h"

/* Conditions: bits of enum nf_arming_reason that hold now, and these above the 22 that are kept for them.
 * SWITCH_NOT_CYCLED and CRASHED are computed by safety and ignored on input. */
#define SAFETY_REASON(name) (1u << NF_ARMING_REASON_##name)
#define SAFETY_SWITCH_ON (1u << 22)
#define SAFETY_OFF_HEARD (1u << 23)      /* the last frame says off, whatever the link's state */
#define SAFETY_RECEIVER_HELD (1u << 24)  /* silent, but not yet lost */
#define SAFETY_GYRO_INVALID (1u << 25)   /* this, stuck and silent: with the reason GYRO_BAD */
#define SAFETY_GYRO_STUCK (1u << 26)
#define SAFETY_GYRO_SATURATED (1u << 27) /* for NF_GYRO_SATURATED_MS */
#define SAFETY_GYRO_SILENT (1u << 28)
#define SAFETY_CRASH (1u << 29)
#define SAFETY_RUNAWAY (1u << 30)
#define SAFETY_NO_CONTROLLER (1u << 31)

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
bool safety_update(struct safety *safety, uint32_t conditions);

/* A control step has passed. */
void safety_tick(struct safety *safety);

/* May the motors turn? */
bool safety_motors(const struct safety *safety);

/* Is this a failsafe descent (rates centred, throttle of the setting)? Then the motors may turn. */
bool safety_descending(const struct safety *safety);

/* The reasons among `conditions` as shown to the pilot: with safety's own, and none at all while motors may turn. */
uint32_t safety_reasons(const struct safety *safety, uint32_t conditions);

#endif
