/* Crash detection: a rate error that the controller cannot correct. */
#pragma once

#include "nf_contract.h"
#include "safety/turning.h"

enum crash_verdict {
	CRASH_NONE,
	CRASH_HAPPENED, /* in the air: large error for NF_CRASH_MS that does not fall although the controller acts */
	CRASH_RUNAWAY,  /* error that grows for NF_RUNAWAY_MS, until just after take-off */
};

/* All times in control steps; 0 as a limit: never. */
struct crash {
	uint32_t crash_after, runaway_after, window;
	uint32_t flown;    /* since the throttle was first raised in the air, at most window */
	uint32_t helpless; /* consecutive steps with a large error that does not fall although the controller acts */
	uint32_t away;     /* consecutive steps in which the error grows */
	float first_rate;  /* rad/s, the axis' rate at the first of them, without its sign */
};

void crash_init(struct crash *crash, const struct nf_settings *settings, unsigned control_rate_hz);

/* A flight begins. */
void crash_reset(struct crash *crash);

/* Another controller takes over: what the last one could not correct does not count. */
void crash_relieve(struct crash *crash);

/* Is crash detection on? */
bool crash_watches(const struct crash *crash);

struct crash_input {
	const float *setpoint, *rate;  /* [3] rad/s, body */
	const struct turning *turning; /* after this control step */
	float spread; /* between the largest and the smallest motor fraction of the controller's answer */
	bool airborne; /* it has taken off */
	bool thrust; /* and the throttle is raised */
};

/* One control step. The axis with the largest error counts; an error is large above NF_CRASH_ERROR_DEG_S. An axis that turns
 * towards its setpoint, or turns that way as fast as the aircraft can, has not crashed. */
enum crash_verdict crash_step(struct crash *crash, const struct crash_input *input);
