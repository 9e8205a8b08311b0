/* Dynamic idle: raises the idle so far that the slowest motor keeps a speed. A rotor that nearly stands in a dive or behind a
 * hard stop answers late, and may lose its step. */
#pragma once

#include "nf_contract.h"
#include "policy.h"

struct dynamic_idle {
	float wanted; /* rad/s that the slowest motor keeps; 0: off */
	float period_s; /* of a control step */
	float sum; /* output, 0 to NF_DYNAMIC_IDLE_MAX: what a lasting lack of speed has raised the idle by */
};

void dynamic_idle_init(struct dynamic_idle *idle, const struct nf_settings *settings, unsigned control_rate_hz);

/* Motors at rest: nothing is raised. */
void dynamic_idle_reset(struct dynamic_idle *idle);

/* One control step: returns what the idle is raised by, output, 0 to NF_DYNAMIC_IDLE_MAX. speed: [rad/s], as ESCs tell it;
 * silent: bit field of motors that do not: while there is one, what was raised fades. */
float dynamic_idle_step(struct dynamic_idle *idle, const float speed[POLICY_ACTION_COUNT], uint32_t silent);
