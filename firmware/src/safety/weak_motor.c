#include "safety/weak_motor.h"

#include <string.h>

#include "common/nf_math.h"

#define LEAST_OUTPUT 0.05f /* below, the speed depends on the idle more than on the motor */

void weak_motor_init(struct weak_motor *weak, unsigned control_rate_hz)
{
	memset(weak, 0, sizeof *weak);
	weak->smoothing = nf_one_minus_exp(1000.0f / (float)(control_rate_hz * NF_WEAK_MOTOR_FILTER_MS));
	weak->patience = control_rate_hz * NF_WEAK_MOTOR_MS / (1000u * POLICY_ACTION_COUNT);
}

void weak_motor_reset(struct weak_motor *weak)
{
	weak->weak = 0;
	weak->next = 0;
	weak->best = weak->found = 0.0f;
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		weak->looks[i] = 0;
		weak->told[i] = weak->given[i] = 0.0f;
	}
}

/* One motor a step: a division each would be a lot. */
static void weak_motor_look(struct weak_motor *weak, unsigned motor, bool silent)
{
	if (silent || weak->given[motor] < LEAST_OUTPUT) {
		weak->looks[motor] = 0;
		return;
	}
	const float gives = weak->told[motor] / weak->given[motor];
	weak->found = gives > weak->found ? gives : weak->found;
	weak->looks[motor] = gives < NF_WEAK_MOTOR_SHARE * weak->best ? weak->looks[motor] + 1u : 0u;
	if (weak->looks[motor] >= weak->patience)
		weak->weak |= (uint8_t)(1u << motor);
}

void weak_motor_step(struct weak_motor *weak, const float speed[POLICY_ACTION_COUNT], uint32_t silent,
		     const float output[POLICY_ACTION_COUNT])
{
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		weak->told[i] += weak->smoothing * (speed[i] - weak->told[i]);
		weak->given[i] += weak->smoothing * (output[i] - weak->given[i]);
	}
	weak_motor_look(weak, weak->next, (silent >> weak->next & 1u) != 0);
	if (++weak->next < POLICY_ACTION_COUNT)
		return;
	weak->next = 0;
	weak->best = weak->found;
	weak->found = 0.0f;
}
