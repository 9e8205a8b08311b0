#include "sensing/calibration.h"

#include "nf_contract.h"

#define COUNTS_PER_DEG_S ((float)NF_GYRO_COUNTS / (float)NF_GYRO_FULL_SCALE_DEG_S)
#define VARIANCE(deg_s) ((int64_t)((deg_s) * COUNTS_PER_DEG_S * (deg_s) * COUNTS_PER_DEG_S)) /* counts^2 */
#define BIAS_MILLICOUNTS ((uint32_t)(1000.0f * NF_CALIBRATION_BIAS_DEG_S * COUNTS_PER_DEG_S))

void calibration_init(struct calibration *calibration, unsigned gyro_rate_hz)
{
	*calibration = (struct calibration){ .window = gyro_rate_hz * NF_CALIBRATION_MS / 1000u };
}

void calibration_restart(struct calibration *calibration)
{
	calibration->collected = 0;
	for (int i = 0; i < 3; ++i) {
		calibration->sum[i] = 0;
		calibration->sum_of_squares[i] = 0;
	}
}

/* Do the sums say that the aircraft was at rest? Exact in integers: at most 8000 squares of 2^30, times 8000. */
static bool calibration_still(const struct calibration *calibration, bool calm)
{
	const int64_t variance = calm ? VARIANCE(NF_CALIBRATION_CALM_DEG_S) : VARIANCE(NF_CALIBRATION_MOTION_DEG_S);
	const int64_t n = calibration->window;
	const int64_t largest_sum = (uint32_t)n * BIAS_MILLICOUNTS / 1000u; /* below 2^32: 8000 times 328000 */

	for (int i = 0; i < 3; ++i) {
		const int64_t sum = calibration->sum[i];
		/* Multiplied out: a division of 64 bits takes 0.7 KB of flash. */
		const int64_t spread = n * calibration->sum_of_squares[i] - sum * sum; /* variance times n * n */
		if (spread >= (variance + 1) * n * n || sum > largest_sum || sum < -largest_sum)
			return false;
	}
	return true;
}

bool calibration_step(struct calibration *calibration, const int16_t counts[3], bool calm, float mean[3])
{
	for (int i = 0; i < 3; ++i) {
		calibration->sum[i] += counts[i];
		calibration->sum_of_squares[i] += (int32_t)counts[i] * counts[i];
	}
	if (++calibration->collected < calibration->window)
		return false;
	const bool good = calibration_still(calibration, calm);
	if (good) {
		/* The samples stayed within the stillness limits: a sum of at most 8000 times 328 counts is exact in
		 * float32 too. */
		for (int i = 0; i < 3; ++i)
			mean[i] = (float)(int32_t)calibration->sum[i] / (float)calibration->window;
	}
	calibration_restart(calibration);
	return good;
}
