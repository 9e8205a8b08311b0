#include "gyro.h"

#include "nf_contract.h"

/* rad/s of one count: 2000 deg/s over 32768 counts, pi/180. One constant, one rounding. */
#define RATE_PER_COUNT 1.0652644360316954e-3f
_Static_assert(NF_GYRO_FULL_SCALE_DEG_S == 2000 && NF_GYRO_COUNTS == 32768, "RATE_PER_COUNT says otherwise");

#define COUNTS_PER_DEG_S ((float)NF_GYRO_COUNTS / (float)NF_GYRO_FULL_SCALE_DEG_S)
#define MOTION_COUNTS (NF_CALIBRATION_MOTION_DEG_S * COUNTS_PER_DEG_S)
#define MOTION_VARIANCE ((int64_t)(MOTION_COUNTS * MOTION_COUNTS)) /* counts^2 */
#define BIAS_MILLICOUNTS ((int64_t)(1000.0f * NF_CALIBRATION_BIAS_DEG_S * COUNTS_PER_DEG_S))

/* Body axis i is chip axis `axis[i]` times `sign[i]`. Turned clockwise, the chip's x points to the right. */
static const struct rotation {
	uint8_t axis[3];
	int8_t sign[3];
} rotations[] = {
	[ALIGN_CW0] = { { 0, 1, 2 }, { 1, 1, 1 } },
	[ALIGN_CW90] = { { 1, 0, 2 }, { 1, -1, 1 } },
	[ALIGN_CW180] = { { 0, 1, 2 }, { -1, -1, 1 } },
	[ALIGN_CW270] = { { 1, 0, 2 }, { -1, 1, 1 } },
};
_Static_assert(sizeof rotations / sizeof rotations[0] == ALIGN_COUNT, "one rotation an alignment");

static void to_body(enum board_alignment alignment, const float chip[3], float body[3])
{
	const struct rotation *r = &rotations[alignment];

	for (int i = 0; i < 3; i++)
		body[i] = (float)r->sign[i] * chip[r->axis[i]];
}

static void restart(struct gyro *gyro)
{
	gyro->collected = 0;
	for (int i = 0; i < 3; i++) {
		gyro->sum[i] = 0;
		gyro->sum_of_squares[i] = 0;
	}
}

enum nf_err gyro_init(struct gyro *gyro, unsigned gyro_rate_hz, enum board_alignment alignment)
{
	if ((unsigned)alignment >= ALIGN_COUNT)
		return NF_ERR_ALIGNMENT;
	*gyro = (struct gyro){
		.alignment = alignment,
		.window = gyro_rate_hz * NF_CALIBRATION_MS / 1000u,
	};
	return NF_OK;
}

/* Did the sums come from an aircraft at rest? Exact in integers: at most 8000 squares of 2^30, times 8000. */
static bool still(const struct gyro *gyro)
{
	const int64_t n = gyro->window;
	const int64_t largest_sum = n * BIAS_MILLICOUNTS / 1000;

	for (int i = 0; i < 3; i++) {
		const int64_t sum = gyro->sum[i];
		const int64_t variance = (n * gyro->sum_of_squares[i] - sum * sum) / (n * n);
		if (variance > MOTION_VARIANCE || sum > largest_sum || sum < -largest_sum)
			return false;
	}
	return true;
}

static void calibrate(struct gyro *gyro, const int16_t counts[3])
{
	for (int i = 0; i < 3; i++) {
		gyro->sum[i] += counts[i];
		gyro->sum_of_squares[i] += (int32_t)counts[i] * counts[i];
	}
	if (++gyro->collected < gyro->window)
		return;
	if (still(gyro)) {
		float mean[3];
		/* What is still fits: 8000 times 328 counts, exact in float32 too. */
		for (int i = 0; i < 3; i++)
			mean[i] = (float)(int32_t)gyro->sum[i] / (float)gyro->window * RATE_PER_COUNT;
		to_body(gyro->alignment, mean, gyro->bias);
		gyro->calibrated = true;
	}
	restart(gyro);
}

void gyro_step(struct gyro *gyro, const int16_t counts[3], float rate[3])
{
	const float chip[3] = {
		(float)counts[0] * RATE_PER_COUNT,
		(float)counts[1] * RATE_PER_COUNT,
		(float)counts[2] * RATE_PER_COUNT,
	};

	if (!gyro->calibrated)
		calibrate(gyro, counts);
	to_body(gyro->alignment, chip, rate);
	for (int i = 0; i < 3; i++)
		rate[i] -= gyro->bias[i];
}
