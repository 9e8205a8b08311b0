/* Arming: when the motors may turn. The one place that decides it. */
#ifndef NF_ARMING_H
#define NF_ARMING_H

#include <stdbool.h>
#include <stdint.h>

#include "nf_contract.h"

enum arming_state {
	ARMING_LOCKED, /* the switch must be seen off before it can arm */
	ARMING_READY,  /* the switch was seen off; moving it on arms if nothing forbids it */
	ARMING_ARMED,
	ARMING_STATE_COUNT,
};

struct arming {
	enum arming_state state;
};

/* Starts locked: a switch that is on at boot never arms. */
void arming_init(struct arming *arming);

/* Called for every receiver frame and every control step. `reasons`: bit field of enum nf_arming_reason
 * that hold now, SWITCH_NOT_CYCLED left out (it is this module's own). Returns whether this call armed. */
bool arming_step(struct arming *arming, uint32_t reasons, bool switch_on);

bool arming_is_armed(const struct arming *arming);

/* `reasons` as shown to the pilot: with the module's own, and none at all while armed. */
uint32_t arming_reasons(const struct arming *arming, uint32_t reasons);

#endif
