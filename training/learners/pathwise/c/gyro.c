#include "aircraft.h"

static const real quarter_phase[3] = {R(0), R(0.25), R(0.125)}; /* turns, between the axes of the vibration */

/* At h + 2 times the turns. */
static void gyro_vibrate_faster(const struct gyros *g, const struct plan *p, const struct turning *t, const real *shake,
				size_t h, real *reading)
{
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const real strength = t->after[m * LANES + l] / p->gyro.speed_max;
			const real phase = R(h + 2u) * g->phase[m * LANES + l];

			for (size_t j = 0; j < 3; ++j)
				reading[j * LANES + l] += p->gyro.amplitude[j] * shake[l] * p->gyro.harmonics[h] *
							  strength * strength * sine_of(phase + quarter_phase[j]);
		}
}

/* An unbalanced rotor shakes across its own axis in a circle, with the square of its speed. */
static void gyro_vibrate(struct gyros *g, const struct plan *p, const struct turning *t, const real *shake, real *reading)
{
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const real strength = t->after[m * LANES + l] / p->gyro.speed_max;
			const real turned = g->phase[m * LANES + l] +
					    p->dt * R(0.07957747154594767) *
						    (t->before[m * LANES + l] + t->after[m * LANES + l]);
			const real phase = turned - real_rint(turned);

			g->phase[m * LANES + l] = phase;
			for (size_t j = 0; j < 3; ++j)
				reading[j * LANES + l] += p->gyro.amplitude[j] * shake[l] * strength * strength *
							  sine_of(phase + quarter_phase[j]);
		}
	for (size_t h = 0; h < 2; ++h)
		if (p->gyro.harmonics[h] != R(0))
			gyro_vibrate_faster(g, p, t, shake, h, reading);
}

/* The chip's 16-bit counts, as the firmware turns them back into a rate. */
static inline real gyro_counted(const struct gyro *gyro, real rate)
{
	return limited(real_rint(rate * gyro->counts), -gyro->count_max - R(1), gyro->count_max) / gyro->counts;
}

/* The reading of a sample, rows (3); of the first there is no turning. */
static void gyro_read(struct gyros *g, const struct plan *p, const struct block *b, size_t sample,
		      const struct turning *t, const real *rate, real *restrict reading)
{
	const struct gyro *const gyro = &p->gyro;
	const real *const noise = b->noise + sample * 3u * LANES;
	const real follow = t == NULL ? R(1) : gyro->follow;

	for (size_t j = 0; j < 3; ++j)
		FOR_LANES(l) {
			const real input = gyro->turned ? rate[l] * gyro->turn[j] +
								  rate[LANES + l] * gyro->turn[3u + j] +
								  rate[2 * LANES + l] * gyro->turn[6u + j] :
							  rate[j * LANES + l];
			const real before = g->lagged[j * LANES + l];
			const real lagged = follow < R(1) ? real_fma(follow, input - before, before) : input;

			g->lagged[j * LANES + l] = lagged;
			reading[j * LANES + l] = lagged + noise[j * LANES + l];
		}
	if (gyro->vibrates && t != NULL)
		gyro_vibrate(g, p, t, b->shake, reading);
	for (size_t i = 0; p->rounded && i < 3u * LANES; ++i)
		reading[i] = gyro_counted(gyro, reading[i]);
}

/* The first sample counts as if there had been as many of it as are seen. */
void gyro_begin(struct gyros *g, const struct plan *p, const struct block *b, const real *rate, real *kept)
{
	real reading[3 * LANES];

	if (p->gyro.vibrates)
		rows_copy(g->phase, b->phase, p->motors);
	gyro_read(g, p, b, 0, NULL, rate, reading);
	if (p->notches.harmonics > 0) {
		notches_begin(&g->notches, p, kept);
		notches_sample(&g->notches, p, 0, reading);
	}
	rows_clear(g->sum, 3);
	for (uint32_t s = 0; s < p->seen; ++s)
		for (size_t i = 0; i < 3u * LANES; ++i)
			g->sum[i] += reading[i];
}

/* Is sample n among those whose mean the next control step sees, or the one at it? */
static bool gyro_seen(const struct plan *p, size_t n)
{
	return (p->samples - n % p->samples) % p->samples < p->seen;
}

/* Takes the reading after a sample. The rotors' speeds are told at control steps. */
void gyro_sample(struct gyros *g, const struct plan *p, const struct block *b, size_t sample, const struct turning *t,
		 const real *rate)
{
	real reading[3 * LANES];

	gyro_read(g, p, b, sample, t, rate, reading);
	if (p->notches.harmonics > 0) {
		if (sample % p->samples == 0)
			rotors_told(p, p->controller.rotors_late ? t->before : t->after, g->notches.told);
		notches_sample(&g->notches, p, sample, reading);
	}
	for (size_t i = 0; gyro_seen(p, sample) && i < 3u * LANES; ++i)
		g->sum[i] += reading[i];
}

/* What the controllers see, rows (3). */
void gyro_mean(struct gyros *g, const struct plan *p, real *mean)
{
	const real share = R(1) / R(p->seen);

	for (size_t i = 0; i < 3u * LANES; ++i)
		mean[i] = g->sum[i] * share;
	rows_clear(g->sum, 3);
}

/* Adds to by_rate what goes through the reading of a sample. Counts, noise and vibration are taken as constant. */
void gyro_sample_back(struct by_gyros *g, const struct plan *p, size_t sample, real *by_rate)
{
	const struct gyro *const gyro = &p->gyro;
	const real follow = sample == 0 ? R(1) : gyro->follow;
	real by_input[3 * LANES], by_reading[3 * LANES] = {0};

	if (gyro_seen(p, sample))
		rows_copy(by_reading, g->by_mean, 3);
	if (p->notches.harmonics > 0)
		notches_back(&g->notches, p, sample, by_reading);
	for (size_t i = 0; i < 3u * LANES; ++i) {
		const real by_lagged = by_reading[i] + g->by_lagged[i];

		by_input[i] = follow * by_lagged;
		g->by_lagged[i] = (R(1) - follow) * by_lagged;
	}
	for (size_t j = 0; j < 3; ++j)
		FOR_LANES(l)
			by_rate[j * LANES + l] += gyro->turned ? gyro->turn[3u * j] * by_input[l] +
									 gyro->turn[3u * j + 1u] * by_input[LANES + l] +
									 gyro->turn[3u * j + 2u] * by_input[2 * LANES + l] :
								 by_input[j * LANES + l];
}
