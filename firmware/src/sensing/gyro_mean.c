#include "sensing/gyro_mean.h"

#include <string.h>

void gyro_mean_init(struct gyro_mean *mean, uint32_t count)
{
	memset(mean, 0, sizeof *mean);
	if (count <= 1 || count > GYRO_MEAN_MAX)
		return;
	mean->count = count;
	mean->share = 1.0f / (float)count;
}

/* Never in flight: that path does without it. */
static __attribute__((noinline)) void gyro_mean_begin(struct gyro_mean *mean, const float rate[3])
{
	for (uint32_t i = 0; i < mean->count; ++i)
		memcpy(mean->last[i], rate, sizeof mean->last[i]);
	mean->begun = true;
}

void gyro_mean_take(struct gyro_mean *mean, const float rate[3])
{
	if (mean->count == 0)
		return;
	if (!mean->begun)
		gyro_mean_begin(mean, rate);
	float *kept = mean->last[mean->oldest];
	for (int axis = 0; axis < 3; ++axis)
		kept[axis] = rate[axis];
	mean->oldest = mean->oldest + 1u == mean->count ? 0u : mean->oldest + 1u;
}

void gyro_mean_read(const struct gyro_mean *mean, float rate[3])
{
	if (mean->count == 0)
		return;
	const float *sample = mean->last[mean->oldest];
	float x = sample[0], y = sample[1], z = sample[2];

	for (uint32_t i = 1, at = mean->oldest; i < mean->count; ++i) {
		at = at + 1u == mean->count ? 0u : at + 1u;
		sample = mean->last[at];
		x += sample[0];
		y += sample[1];
		z += sample[2];
	}
	rate[0] = x * mean->share;
	rate[1] = y * mean->share;
	rate[2] = z * mean->share;
}
