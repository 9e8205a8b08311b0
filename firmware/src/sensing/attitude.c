#include "sensing/attitude.h"

#include "common/limit.h"
#include "common/nf_math.h"
#include "nf_contract.h"

/* Gains. The accelerometer corrects with a time constant of 1/gain: slowly in flight, where it also measures rotor
 * thrust and drag; quickly while settling, when the aircraft stands on the ground. */
#define GAIN 0.5f          /* rad/s for a sine of 1 */
#define GAIN_SETTLING 10.0f
#define GAIN_BIAS 0.05f    /* rad/s^2; with GAIN: damping 1.1 */
#define BIAS_MAX 0.1f      /* rad/s: above the bias that remains after calibration and warming up */
#define SETTLING_MS 1000u
#define SHORTEST (0.85f * 0.85f) /* g^2 */
#define LONGEST (1.15f * 1.15f)
#define OPPOSITE -0.9999f  /* up this near to the body's -z: the arc below has no axis */

void attitude_init(struct attitude *attitude, unsigned rate_hz)
{
	*attitude = (struct attitude){
		.q = { 1.0f, 0.0f, 0.0f, 0.0f },
		.period = 1.0f / (float)rate_hz,
		.settling = rate_hz * SETTLING_MS / 1000u,
	};
}

/* The direction of the acceleration, where its length may be gravity's. */
static bool attitude_trust(const float acceleration[3], float up[3])
{
	const float x = acceleration[0] * (1.0f / NF_GRAVITY);
	const float y = acceleration[1] * (1.0f / NF_GRAVITY);
	const float z = acceleration[2] * (1.0f / NF_GRAVITY);
	const float square = x * x + y * y + z * z;

	if (!(square >= SHORTEST && square <= LONGEST))
		return false;
	const float shorten = 1.0f / __builtin_sqrtf(square);
	up[0] = x * shorten;
	up[1] = y * shorten;
	up[2] = z * shorten;
	return true;
}

static void attitude_normalise(float q[4])
{
	const float shorten = 1.0f / __builtin_sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);

	for (int i = 0; i < 4; ++i)
		q[i] *= shorten;
}

/* The shortest turn that carries the measured `up` to the world's z. Once after boot: the path of a flight does without it. */
static __attribute__((noinline)) void attitude_begin(struct attitude *attitude, const float up[3])
{
	float *q = attitude->q;

	if (up[2] > OPPOSITE) {
		q[0] = 1.0f + up[2];
		q[1] = up[1];
		q[2] = -up[0];
	} else { /* upside down: by roll, as good as any */
		q[0] = 0.0f;
		q[1] = 1.0f;
		q[2] = 0.0f;
	}
	q[3] = 0.0f;
	attitude_normalise(q);
	attitude->begun = true;
}

/* Adds the correction that turns the estimated up towards the measured one: their cross product. */
static void attitude_pull(struct attitude *attitude, const float measured[3], float rate[3])
{
	float up[3];

	attitude_up(attitude, up);
	const float error[3] = {
		measured[1] * up[2] - measured[2] * up[1],
		measured[2] * up[0] - measured[0] * up[2],
		measured[0] * up[1] - measured[1] * up[0],
	};
	const bool settling = attitude->settling > 0;
	const float gain = settling ? GAIN_SETTLING : GAIN;

	for (int i = 0; i < 3; ++i) {
		const float bias = attitude->bias[i] + GAIN_BIAS * attitude->period * error[i];
		if (!settling) /* the larger gain of the start must not enter the bias */
			attitude->bias[i] = limit(bias, -BIAS_MAX, BIAS_MAX);
		rate[i] += gain * error[i];
	}
	if (settling)
		--attitude->settling;
}

/* q += 1/2 q (0, rate) dt */
static void attitude_turn(struct attitude *attitude, const float rate[3])
{
	const float half = 0.5f * attitude->period;
	const float x = half * rate[0], y = half * rate[1], z = half * rate[2];
	float *q = attitude->q;
	const float a = q[0], b = q[1], c = q[2], d = q[3];

	q[0] = a - (b * x + c * y + d * z);
	q[1] = b + (a * x + c * z - d * y);
	q[2] = c + (a * y - b * z + d * x);
	q[3] = d + (a * z + b * y - c * x);
	attitude_normalise(q);
}

void attitude_step(struct attitude *attitude, const float rate[3], const float acceleration[3])
{
	float turning[3], measured[3];

	for (int i = 0; i < 3; ++i)
		turning[i] = rate[i] + attitude->bias[i];
	if (attitude_trust(acceleration, measured)) {
		if (!attitude->begun)
			attitude_begin(attitude, measured);
		attitude_pull(attitude, measured, turning);
	}
	attitude_turn(attitude, turning);
}

bool attitude_known(const struct attitude *attitude)
{
	return attitude->settling == 0;
}

void attitude_up(const struct attitude *attitude, float up[3])
{
	const float *q = attitude->q;

	up[0] = 2.0f * (q[1] * q[3] - q[0] * q[2]);
	up[1] = 2.0f * (q[2] * q[3] + q[0] * q[1]);
	up[2] = q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3];
}

void attitude_euler_deg(const struct attitude *attitude, float angles[3])
{
	const float *q = attitude->q;
	float up[3];

	attitude_up(attitude, up);
	angles[0] = NF_DEG_PER_RAD * nf_atan2(up[1], up[2]);
	angles[1] = NF_DEG_PER_RAD * nf_asin(-up[0]);
	angles[2] = NF_DEG_PER_RAD *
		    nf_atan2(2.0f * (q[1] * q[2] + q[0] * q[3]), q[0] * q[0] + q[1] * q[1] - q[2] * q[2] - q[3] * q[3]);
}
