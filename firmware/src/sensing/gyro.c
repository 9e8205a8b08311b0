#include "sensing/gyro.h"

#include "common/limit.h"
#include "common/nf_math.h"

/* rad/s of one count: 2000 deg/s over 32768 counts, pi/180. One constant, one rounding. */
#define RATE_PER_COUNT 1.0652644360316954e-3f
_Static_assert(NF_GYRO_FULL_SCALE_DEG_S == 2000 && NF_GYRO_COUNTS == 32768, "RATE_PER_COUNT says otherwise");
#define ACCELERATION_PER_COUNT (NF_GRAVITY * (float)NF_ACCEL_FULL_SCALE_G / (float)NF_ACCEL_COUNTS) /* m/s^2 */
#define DRIFT (NF_CALIBRATION_DRIFT_DEG_S * NF_RAD_PER_DEG)
#define STEP (NF_CALIBRATION_STEP_DEG_S * NF_RAD_PER_DEG)
#define FULL_SWING (2.0f * (float)NF_GYRO_COUNTS) /* counts */

/* Body axis i is chip axis `axis[i]` times `sign[i]`. Turned clockwise, the chip's x points to the right; flipped, half a
 * turn about its own y comes first. */
static const struct rotation {
	uint8_t axis[3];
	int8_t sign[3];
} rotations[] = {
	[ALIGN_CW0] = { { 0, 1, 2 }, { 1, 1, 1 } },          [ALIGN_CW90] = { { 1, 0, 2 }, { 1, -1, 1 } },
	[ALIGN_CW180] = { { 0, 1, 2 }, { -1, -1, 1 } },      [ALIGN_CW270] = { { 1, 0, 2 }, { -1, 1, 1 } },
	[ALIGN_CW0_FLIP] = { { 0, 1, 2 }, { -1, 1, -1 } },   [ALIGN_CW90_FLIP] = { { 1, 0, 2 }, { 1, 1, -1 } },
	[ALIGN_CW180_FLIP] = { { 0, 1, 2 }, { 1, -1, -1 } }, [ALIGN_CW270_FLIP] = { { 1, 0, 2 }, { -1, -1, -1 } },
};
_Static_assert(sizeof rotations / sizeof rotations[0] == ALIGN_COUNT, "one rotation an alignment");

/* Data sheets: MPU-6500 rev. 1.1 and ICM-20689 rev. 1.1, register TEMP_OUT. The others of InvenSense are from PX4's
 * register headers, the LSM6DS's from ST's driver; ICM-20601 and LSM6DSK320X are assumed to equal their families, because
 * their data sheets were not read. */
static const struct thermometer {
	float counts_per_degree;
	float zero_c; /* at 0 counts */
} thermometers[] = {
	[GYRO_MPU6500] = { 333.87f, 21.0f },   [GYRO_ICM20689] = { 326.8f, 25.0f },
	[GYRO_ICM20602] = { 326.8f, 25.0f },   [GYRO_ICM20601] = { 326.8f, 25.0f },
	[GYRO_ICM20608G] = { 326.8f, 25.0f },  [GYRO_MPU9250] = { 333.87f, 21.0f },
	[GYRO_MPU6000] = { 340.0f, 36.53f },   [GYRO_ICM42688P] = { 132.48f, 25.0f },
	[GYRO_ICM42605] = { 132.48f, 25.0f },  [GYRO_BMI270] = { 512.0f, 23.0f },
	[GYRO_LSM6DSV16X] = { 256.0f, 25.0f }, [GYRO_LSM6DSK320X] = { 256.0f, 25.0f },
};
_Static_assert(sizeof thermometers / sizeof thermometers[0] == NF_GYRO_IDENTITIES_COUNT, "one thermometer a chip");

static __attribute__((noinline)) void gyro_turn(const float turn[3][3], float vector[3])
{
	const float board[3] = { vector[0], vector[1], vector[2] };

	for (int i = 0; i < 3; ++i)
		vector[i] = turn[i][0] * board[0] + turn[i][1] * board[1] + turn[i][2] * board[2];
}

static void gyro_to_body(const struct gyro *gyro, const float chip[3], float body[3])
{
	const struct rotation *r = &rotations[gyro->alignment];

	for (int i = 0; i < 3; ++i)
		body[i] = (float)r->sign[i] * chip[r->axis[i]];
	if (gyro->turned)
		gyro_turn(gyro->turn, body);
}

enum nf_err gyro_init(struct gyro *gyro, unsigned gyro_rate_hz, enum board_alignment alignment, unsigned stuck_ms)
{
	if ((unsigned)alignment >= ALIGN_COUNT)
		return NF_ERR_ALIGNMENT;
	*gyro = (struct gyro){
		.alignment = alignment,
		.rests = true,
		.turn = { { 1.0f, 0.0f, 0.0f }, { 0.0f, 1.0f, 0.0f }, { 0.0f, 0.0f, 1.0f } },
		.bad_after = gyro_rate_hz * NF_GYRO_BAD_MS / 1000u,
		.saturated_after = gyro_rate_hz * NF_GYRO_SATURATED_MS / 1000u,
		.stuck_after = gyro_rate_hz * stuck_ms / 1000u,
		/* After a step over the whole range, a first-order low-pass changes faster than all others. */
		.jump = (int32_t)(FULL_SWING * nf_one_minus_exp(NF_TAU * NF_GYRO_BANDWIDTH_HZ / (float)gyro_rate_hz)),
	};
	calibration_init(&gyro->calibration, gyro_rate_hz);
	return NF_OK;
}

static float gyro_sine_init(float deg)
{
	return deg < 0.0f ? -nf_sin_turns(-deg / 360.0f) : nf_sin_turns(deg / 360.0f);
}

static float gyro_cosine_init(float deg)
{
	return nf_cos_turns(deg < 0.0f ? -deg / 360.0f : deg / 360.0f);
}

void gyro_board_init(struct gyro *gyro, float roll_deg, float pitch_deg, float yaw_deg)
{
	const float sx = gyro_sine_init(roll_deg), cx = gyro_cosine_init(roll_deg);
	const float sy = gyro_sine_init(pitch_deg), cy = gyro_cosine_init(pitch_deg);
	const float sz = gyro_sine_init(yaw_deg), cz = gyro_cosine_init(yaw_deg);
	const float turn[3][3] = {
		{ cy * cz, cx * sz + sx * sy * cz, sx * sz - cx * sy * cz },
		{ -cy * sz, cx * cz - sx * sy * sz, sx * cz + cx * sy * sz },
		{ sy, -sx * cy, cx * cy },
	};

	if (roll_deg == 0.0f && pitch_deg == 0.0f && yaw_deg == 0.0f)
		return;
	gyro->turned = true;
	for (int j = 0; j < 3; ++j) {
		float axis[3] = { gyro->turn[0][j], gyro->turn[1][j], gyro->turn[2][j] };

		gyro_turn(turn, axis);
		for (int i = 0; i < 3; ++i)
			gyro->turn[i][j] = axis[i];
	}
}

/* Moves the bias towards the mean of a still window, unless an axis is so far away that it must be turning. */
static void gyro_follow(struct gyro *gyro, const float found[3])
{
	float away[3];

	for (int i = 0; i < 3; ++i) {
		away[i] = found[i] - gyro->bias[i];
		if (away[i] > DRIFT || away[i] < -DRIFT)
			return;
	}
	for (int i = 0; i < 3; ++i)
		gyro->bias[i] += limit(away[i], -STEP, STEP);
}

/* Never in flight: that path does without it. */
static __attribute__((noinline)) void gyro_calibrate(struct gyro *gyro, const int16_t counts[3], bool good)
{
	float mean[3], found[3];

	if (!good)
		calibration_restart(&gyro->calibration);
	if (!good || !calibration_step(&gyro->calibration, counts, gyro->calibrated, mean))
		return;
	for (int i = 0; i < 3; ++i)
		mean[i] *= RATE_PER_COUNT;
	gyro_to_body(gyro, mean, found);
	if (gyro->calibrated) {
		gyro_follow(gyro, found);
		return;
	}
	for (int i = 0; i < 3; ++i)
		gyro->bias[i] = found[i];
	gyro->calibrated = true;
}

void gyro_rest(struct gyro *gyro, bool rests)
{
	if (rests && !gyro->rests)
		calibration_restart(&gyro->calibration);
	gyro->rests = rests;
}

/* Classifies a sample. The longer ago the last good one, the larger the allowed change. */
static enum nf_gyro_health gyro_classify(const struct gyro *gyro, const struct imu_sample *sample)
{
	const int32_t reach = gyro->jump * (int32_t)(gyro->bad + 1);
	enum nf_gyro_health health = NF_GYRO_HEALTH_GOOD;

	if (!sample->valid)
		return NF_GYRO_HEALTH_INVALID;
	for (int i = 0; i < 3; ++i) {
		const int32_t counts = sample->gyro[i];
		const int32_t jumped = counts - gyro->last.gyro[i];
		if (jumped > reach || jumped < -reach)
			return NF_GYRO_HEALTH_INVALID;
		if (counts >= NF_GYRO_SATURATED_COUNTS || counts <= -NF_GYRO_SATURATED_COUNTS)
			health = NF_GYRO_HEALTH_SATURATED;
	}
	return health;
}

/* Keeps a good sample. Returns whether all its words equal the last one's: noise makes that rare in a working chip. */
static bool gyro_repeats(struct imu_sample *last, const struct imu_sample *sample)
{
	int changed = last->valid ? last->temperature ^ sample->temperature : 1;

	last->temperature = sample->temperature;
	last->valid = true;
	for (int i = 0; i < 3; ++i) {
		changed |= (last->gyro[i] ^ sample->gyro[i]) | (last->accel[i] ^ sample->accel[i]);
		last->gyro[i] = sample->gyro[i];
		last->accel[i] = sample->accel[i];
	}
	return changed == 0;
}

static void gyro_take(struct gyro *gyro, const struct imu_sample *sample, bool saturated)
{
	gyro->bad = 0;
	if (!saturated)
		gyro->saturated = 0;
	else if (gyro->saturated < gyro->saturated_after)
		++gyro->saturated;
	if (!gyro_repeats(&gyro->last, sample))
		gyro->same = 0;
	else if (gyro->same < gyro->stuck_after)
		++gyro->same;
}

enum nf_gyro_health gyro_step(struct gyro *gyro, const struct imu_sample *sample, float rate[3])
{
	const enum nf_gyro_health judged = gyro_classify(gyro, sample);

	if (judged != NF_GYRO_HEALTH_INVALID)
		gyro_take(gyro, sample, judged == NF_GYRO_HEALTH_SATURATED);
	else if (gyro->bad < gyro->bad_after)
		++gyro->bad;

	if (gyro->bad >= gyro->bad_after)
		gyro->health = NF_GYRO_HEALTH_INVALID;
	else if (gyro->stuck_after > 0 && gyro->same >= gyro->stuck_after)
		gyro->health = NF_GYRO_HEALTH_STUCK;
	else
		gyro->health = gyro->saturated > 0 ? NF_GYRO_HEALTH_SATURATED : NF_GYRO_HEALTH_GOOD;

	if (gyro->rests)
		gyro_calibrate(gyro, sample->gyro,
			       judged == NF_GYRO_HEALTH_GOOD && gyro->health == NF_GYRO_HEALTH_GOOD);

	const int16_t *counts = gyro->last.gyro;
	const float chip[3] = {
		(float)counts[0] * RATE_PER_COUNT,
		(float)counts[1] * RATE_PER_COUNT,
		(float)counts[2] * RATE_PER_COUNT,
	};
	gyro_to_body(gyro, chip, rate);
	for (int i = 0; i < 3; ++i)
		rate[i] -= gyro->bias[i];
	return gyro->health;
}

bool gyro_railed(const struct gyro *gyro)
{
	return gyro->saturated >= gyro->saturated_after;
}

void gyro_acceleration(const struct gyro *gyro, float acceleration[3])
{
	const int16_t *counts = gyro->last.accel;
	const float chip[3] = {
		(float)counts[0] * ACCELERATION_PER_COUNT,
		(float)counts[1] * ACCELERATION_PER_COUNT,
		(float)counts[2] * ACCELERATION_PER_COUNT,
	};

	gyro_to_body(gyro, chip, acceleration);
}

float gyro_temperature_c(const struct gyro *gyro, enum gyro_chip chip)
{
	const struct thermometer *t = &thermometers[chip];

	return (float)gyro->last.temperature / t->counts_per_degree + t->zero_c;
}
