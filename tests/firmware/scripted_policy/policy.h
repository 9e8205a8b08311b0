/* What toolchain/rendering/templates/policy.h.j2 renders, for the scripted policy; @MOTORS@ is set by conftest.py. */
#ifndef NEUROFLIGHT_POLICY_H
#define NEUROFLIGHT_POLICY_H

#define POLICY_OBSERVATION_COUNT (13 + POLICY_ACTION_COUNT)
#define POLICY_ACTION_COUNT @MOTORS@
#define POLICY_WEIGHT_COUNT 2
#define POLICY_CONTROL_RATE_HZ 1000
#define POLICY_ARCHITECTURE_HASH 0x01234567u
#define POLICY_FILTERS_HASH 0x0D4CBB29u
#define POLICY_SELFTEST_COUNT 3
#define POLICY_SELFTEST_STEPS 1
#define POLICY_OBSERVATION_TERM_COUNT 6
#define POLICY_MOTOR_CHECK 0
#define POLICY_IDLE 0.0f
#define POLICY_NAME "scripted"
#define POLICY_SHA256 "00112233445566778899aabbccddeeff0123456789abcdeffedcba9876543210"

struct policy {
	const float *weights;
};

/* The policy as a blob, its self-test included. */
struct policy_blob {
	unsigned char bytes[@BLOB_BYTES@];
};
extern const struct policy_blob policy_blob;

extern float scripted_action[POLICY_ACTION_COUNT];
extern float scripted_observation[POLICY_OBSERVATION_COUNT];
extern unsigned scripted_inits;
extern unsigned scripted_steps;

extern const unsigned char policy_observation_blocks[POLICY_OBSERVATION_TERM_COUNT];
extern const unsigned char policy_observation_ages[POLICY_OBSERVATION_TERM_COUNT];
extern const float policy_observation_gains[POLICY_OBSERVATION_TERM_COUNT];
extern const float policy_weights[POLICY_WEIGHT_COUNT];
extern const float policy_selftest_observation[POLICY_SELFTEST_COUNT][POLICY_OBSERVATION_COUNT];
extern const float policy_selftest_action[POLICY_SELFTEST_COUNT][POLICY_ACTION_COUNT];

void policy_init(struct policy *p, const float *weights);
void policy_step(struct policy *p, const float observation[POLICY_OBSERVATION_COUNT],
		 float action[POLICY_ACTION_COUNT]);

#endif
