/* Crash: does the aircraft do what no pilot asked for, and no controller can mend? */
#ifndef NF_CRASH_H
#define NF_CRASH_H

#include <stdbool.h>
#include <stdint.h>

#include "nf_contract.h"

enum crash_verdict {
	CRASH_NONE,
	CRASH_HAPPENED, /* far off for NF_CRASH_MS, whatever the controller does */
	CRASH_RUNAWAY,  /* turning away, ever faster, for NF_RUNAWAY_MS, just after arming */
};

/* All times in control steps; 0 as a limit: never. */
struct crash {
	uint32_t crash_after, runaway_after, window;
	uint32_t flown;    /* since arming, at most window */
	uint32_t helpless; /* running steps far off in spite of the controller */
	uint32_t away;     /* running steps in which the axis turns away */
	int axis;          /* which one */
	float first_rate;  /* rad/s, its rate at the first of them, without its sign */
};

void crash_init(struct crash *crash, const struct nf_settings *settings, unsigned control_rate_hz);

/* A flight begins. */
void crash_reset(struct crash *crash);

/* One control step. setpoint, rate: rad/s, body axes; spread: between the largest and the smallest motor fraction of
 * the controller's answer. The axis that is furthest off counts; far off is NF_CRASH_ERROR_DEG_S. */
enum crash_verdict crash_step(struct crash *crash, const float setpoint[3], const float rate[3], float spread);

#endif
