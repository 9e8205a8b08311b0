#include "safety/turning.h"

#include "common/nf_math.h"

/* How far the second low-pass lies behind the first while the rate changes by NF_TURNING_DEG_S2: for its time
 * constant, rad/s. */
#define DISTANCE (NF_TURNING_DEG_S2 * NF_RAD_PER_DEG / (NF_TAU * NF_TURNING_FAR_HZ))
#define LIMIT_RATE (NF_TURNING_LIMIT_DEG_S * NF_RAD_PER_DEG)

void turning_init(struct turning *turning, unsigned control_rate_hz)
{
	*turning = (struct turning){
		.near_gain = nf_one_minus_exp(NF_TAU * NF_TURNING_NEAR_HZ / (float)control_rate_hz),
		.far_gain = nf_one_minus_exp(NF_TAU * NF_TURNING_FAR_HZ / (float)control_rate_hz),
	};
}

void turning_reset(struct turning *turning)
{
	turning->started = false;
}

void turning_step(struct turning *turning, const float rate[3])
{
	for (int i = 0; i < 3; ++i) {
		if (!turning->started)
			turning->near[i] = turning->far[i] = rate[i];
		turning->near[i] += turning->near_gain * (rate[i] - turning->near[i]);
		turning->far[i] += turning->far_gain * (turning->near[i] - turning->far[i]);
	}
	turning->started = true;
}

bool turning_at_limit(float rate, float error)
{
	return error > 0.0f ? rate > LIMIT_RATE : rate < -LIMIT_RATE;
}

bool turning_towards(const struct turning *turning, int axis, float error)
{
	const float distance = turning->near[axis] - turning->far[axis];

	return error > 0.0f ? distance > DISTANCE : distance < -DISTANCE;
}
