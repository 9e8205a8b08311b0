/* Gyro mean: at a control step, the mean of the last samples instead of the newest alone. */
#pragma once

#include "nf_contract.h"
#include "policy.h"

#define GYRO_MEAN_MAX (NF_GYRO_EDGE_RATE_HZ / POLICY_CONTROL_RATE_HZ) /* samples */

struct gyro_mean {
	uint32_t count;                /* samples of the mean; 0: off */
	uint32_t oldest;               /* of the ring */
	bool begun;                    /* a sample has come */
	float share;                   /* 1 / count */
	float last[GYRO_MEAN_MAX][3];  /* rad/s: a ring of `count` samples */
};

/* count: of the mean, 1 to GYRO_MEAN_MAX; 0 or 1: off, not a bit changes. */
void gyro_mean_init(struct gyro_mean *mean, uint32_t count);

/* Takes one gyro sample [rad/s]. The first one also fills the samples before it. Lost samples are not replaced: the
 * mean is that of the last samples taken, which then span a longer time. */
void gyro_mean_take(struct gyro_mean *mean, const float rate[3]);

/* The mean [rad/s], oldest first, of samples that were taken; `rate` stays where the mean is off. */
void gyro_mean_read(const struct gyro_mean *mean, float rate[3]);
