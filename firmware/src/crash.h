/* Crash: does the aircraft do what no pilot asked for, and no controller can mend? */
#ifndef NF_CRASH_H
#define NF_CRASH_H

#include <stdbool.h>
#include <stdint.h>

#include "nf_contract.h"

enum crash_verdict {
	CRASH_NONE,
	CRASH_HAPPENED, /* beyond help for NF_CRASH_MS */
	CRASH_RUNAWAY,  /* beyond help and getting worse for NF_RUNAWAY_MS, just after arming */
};

/* All times in control steps; 0 as a limit: never. */
struct crash {
	uint32_t crash_after, runaway_after, window;
	uint32_t flown;    /* since arming, at most window */
	uint32_t beyond;   /* running steps beyond help */
	float first_error; /* rad/s, of the first of them */
};

void crash_init(struct crash *crash, const struct nf_settings *settings, unsigned control_rate_hz);

/* A flight begins. */
void crash_reset(struct crash *crash);

/* One control step: error = setpoint - rate [rad/s, body axes], output: the controller's largest motor fraction
 * before the throttle is laid on. Beyond help: an axis is NF_CRASH_ERROR_DEG_S off while the output is at least
 * NF_CRASH_OUTPUT. */
enum crash_verdict crash_step(struct crash *crash, const float error[3], float output);

#endif
