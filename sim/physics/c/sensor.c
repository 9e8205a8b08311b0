/* Gyro and accelerometer: lag, bias, white noise and vibration of three axes. */
#include "random.h"
#include "vector.h"

#define PI 3.14159265358979323846

/* Phase between axes of the vibration [rad]: an unbalanced rotor shakes across its own axis in a circle. */
static const double vibration_phase[3] = {0.0, PI / 2.0, PI / 4.0};

/* What shakes at multiples of a rotor's turns: blades that pass an arm, a bent shaft. */
static double sensor_multiples(const struct sensor *s, double phase, double axis)
{
	double sum = 0.0;

	for (int i = 0; i < 2; ++i)
		if (s->harmonics[i] != 0.0)
			sum = fma(s->harmonics[i], sin((i + 2) * phase + axis), sum);
	return sum;
}

/* An unbalance pulls with the square of the speed. */
static void sensor_vibrate(const struct sensor *s, double shake, uint32_t motors, const double *phase,
			   const double *speed, double *reading)
{
	for (size_t j = 0; j < 3; ++j) {
		double sum = 0.0;

		for (uint32_t m = 0; m < motors; ++m) {
			const double strength = speed[m] / s->speed_max;

			const double multiples = sensor_multiples(s, phase[m], vibration_phase[j]);
			sum = fma(strength * strength, sin(phase[m] + vibration_phase[j]) + multiples, sum);
		}
		reading[j] += sum * (s->amplitude[j] * shake);
	}
}

static void sensor_read_one(struct sensor *s, size_t i, const double *draw, const double *value, double *reading)
{
	double input[3];

	if (s->turned) {
		row_times(value, s->turn, 3, 3, input);
	} else {
		for (size_t j = 0; j < 3; ++j)
			input[j] = value[j];
	}
	for (size_t j = 0; j < 3; ++j) {
		if (s->lags) {
			double *const lagged = s->lagged + 3u * i + j;
			const double from = s->fresh[i] ? input[j] : *lagged;

			*lagged = input[j] = from + s->follow * (input[j] - from);
		}
		reading[j] = input[j] + s->bias[3u * i + j] + draw[j] * (s->noise[j] * s->factor[i]);
	}
	s->fresh[i] = false;
}

/* Readings of the aircraft of `which` (count), NULL: of the first `count`. value, phase, speed and reading are of all
 * aircraft. phase [rad] and speed [rad/s] of the rotors, (N, M), matter to a sensor that vibrates. */
void sensor_read(struct sensor *s, size_t count, const int64_t *which, const double *value, uint32_t motors,
		 const double *phase, const double *speed, double *reading)
{
	random_standard_normal_fill(s->random, (ptrdiff_t)(3u * count), s->draws);
	for (size_t k = 0; k < count; ++k) {
		const size_t i = which != NULL ? (size_t)which[k] : k;
		double *const read = reading + 3u * i;

		sensor_read_one(s, i, s->draws + 3u * k, value + 3u * i, read);
		if (s->vibrates)
			sensor_vibrate(s, s->shake[i], motors, phase + i * motors, speed + i * motors, read);
		for (size_t j = 0; s->saturates && j < 3; ++j)
			read[j] = fmin(fmax(read[j], -s->full_scale), s->full_scale);
	}
}
