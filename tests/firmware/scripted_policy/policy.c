/* A policy for tests: it answers what a test puts into scripted_action and keeps the last observation. */
#include "policy.h"

float scripted_action[POLICY_ACTION_COUNT];
float scripted_observation[POLICY_OBSERVATION_COUNT];
unsigned scripted_inits;
unsigned scripted_steps;

/* Every block that the firmware has a source for, in the contract's order, as it is. */
const unsigned char policy_observation_blocks[POLICY_OBSERVATION_TERM_COUNT] = { 1, 2, 3, 4, 5, 6 };
const unsigned char policy_observation_ages[POLICY_OBSERVATION_TERM_COUNT];
const float policy_observation_gains[POLICY_OBSERVATION_TERM_COUNT];
_Alignas(8) const struct policy_blob policy_blob = { { @BLOB@ } };
const float policy_weights[POLICY_WEIGHT_COUNT] = { 1.0f, -2.0f };
const float policy_selftest_observation[POLICY_SELFTEST_COUNT][POLICY_OBSERVATION_COUNT];
const float policy_selftest_action[POLICY_SELFTEST_COUNT][POLICY_ACTION_COUNT];

void policy_init(struct policy *p, const float *weights)
{
	p->weights = weights;
	++scripted_inits;
}

void policy_step(struct policy *p, const float observation[POLICY_OBSERVATION_COUNT],
		 float action[POLICY_ACTION_COUNT])
{
	(void)p;
	for (int i = 0; i < POLICY_OBSERVATION_COUNT; ++i)
		scripted_observation[i] = observation[i];
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		action[i] = scripted_action[i];
	++scripted_steps;
}
