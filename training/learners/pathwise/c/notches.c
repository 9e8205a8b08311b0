/* Notches at the rotors' turns and their multiples, firmware/src/sensing/rpm_filter.c: each sample moves those of one motor in
 * turn. */
#include "aircraft.h"

/* Which motor's notches sample n moves. */
static size_t notches_mover(const struct plan *p, size_t n)
{
	return n % p->motors;
}

static void notches_rest(struct notches *f, const struct plan *p, size_t motor)
{
	for (size_t i = motor * p->notches.harmonics * LANES; i < (motor + 1u) * p->notches.harmonics * LANES; ++i) {
		f->gain[i] = p->notches.least_gain;
		f->depth[i] = R(0);
	}
}

/* kept: rows (N, 2 harmonics) of all samples for `notches_back`, or NULL. */
void notches_begin(struct notches *f, const struct plan *p, real *kept)
{
	rows_clear(f->told, p->motors);
	rows_clear(f->band, 3u * p->motors * p->notches.harmonics);
	rows_clear(f->low, 3u * p->motors * p->notches.harmonics);
	for (size_t m = 0; m < p->motors; ++m)
		notches_rest(f, p, m);
	f->kept = kept;
}

/* The tangents of the multiples follow from that of the first by addition. */
static void notches_move(struct notches *f, const struct plan *p, size_t motor)
{
	const struct notch_plan *const own = &p->notches;
	const real *const told = f->told + motor * LANES;
	real first[LANES], gain[LANES];

	FOR_LANES(l) {
		const real half = limited(told[l] * own->turns, R(0), own->highest) * R(0.5);

		gain[l] = first[l] = sine_of(half) / sine_of(half + R(0.25));
	}
	for (size_t i = 0; i < own->harmonics; ++i) {
		real *const to = f->gain + (motor * own->harmonics + i) * LANES;
		real *const depth = f->depth + (motor * own->harmonics + i) * LANES;

		FOR_LANES(l) {
			const real turns = limited(told[l] * own->turns, R(0), own->highest) * R(i + 1u);
			const real part = (turns - own->least) * own->fade;
			const bool there = part > R(0) && turns < own->highest;

			to[l] = there ? gain[l] : to[l];
			depth[l] = there ? own->damping * least(part, R(1)) : R(0);
			gain[l] = (gain[l] + first[l]) / (R(1) - gain[l] * first[l]);
		}
	}
}

/* Filters the reading of sample n, rows (3), in place. */
void notches_sample(struct notches *f, const struct plan *p, size_t n, real *reading)
{
	const size_t harmonics = p->notches.harmonics, count = p->motors * harmonics, motor = notches_mover(p, n);

	notches_move(f, p, motor);
	if (f->kept != NULL) {
		rows_copy(f->kept + 2u * n * harmonics * LANES, f->gain + motor * harmonics * LANES, harmonics);
		rows_copy(f->kept + (2u * n + 1u) * harmonics * LANES, f->depth + motor * harmonics * LANES, harmonics);
	}
	for (size_t i = 0; i < count; ++i)
		for (size_t j = 0; j < 3; ++j) {
			real *const band_kept = f->band + (3u * i + j) * LANES;
			real *const low_kept = f->low + (3u * i + j) * LANES;

			FOR_LANES(l) {
				const real gain = f->gain[i * LANES + l];
				const real scale = R(1) / (R(1) + gain * (gain + p->notches.damping));
				const real in = reading[j * LANES + l];
				const real band = scale * (band_kept[l] + gain * (in - low_kept[l]));
				const real low = low_kept[l] + gain * band;

				band_kept[l] = R(2) * band - band_kept[l];
				low_kept[l] = R(2) * low - low_kept[l];
				reading[j * LANES + l] = in - f->depth[i * LANES + l] * band;
			}
		}
}

/* As they stand at the end of a flight whose last sample is `last`, from what notches_sample has kept; derivatives are 0. */
void notches_end(struct notches *f, const struct plan *p, size_t last, real *kept)
{
	notches_begin(f, p, kept);
	for (size_t m = 0; m < p->motors && m <= last; ++m) {
		const size_t n = last - m, harmonics = p->notches.harmonics, motor = notches_mover(p, n);

		rows_copy(f->gain + motor * harmonics * LANES, kept + 2u * n * harmonics * LANES, harmonics);
		rows_copy(f->depth + motor * harmonics * LANES, kept + (2u * n + 1u) * harmonics * LANES, harmonics);
	}
}

/* From derivatives by the filtered reading of sample n to those by the reading, rows (3), in place: from the last sample to the
 * first. The centres are taken as constant. */
void notches_back(struct notches *f, const struct plan *p, size_t n, real *by)
{
	const size_t harmonics = p->notches.harmonics, motor = notches_mover(p, n);

	for (size_t i = p->motors * harmonics; i-- > 0;)
		for (size_t j = 0; j < 3; ++j) {
			real *const band_kept = f->band + (3u * i + j) * LANES;
			real *const low_kept = f->low + (3u * i + j) * LANES;

			FOR_LANES(l) {
				const real gain = f->gain[i * LANES + l];
				const real scale = R(1) / (R(1) + gain * (gain + p->notches.damping));
				const real by_low = R(2) * low_kept[l];
				const real by_band = scale * (R(2) * band_kept[l] + gain * by_low -
							      f->depth[i * LANES + l] * by[j * LANES + l]);

				band_kept[l] = by_band - band_kept[l];
				low_kept[l] = low_kept[l] - gain * by_band;
				by[j * LANES + l] += gain * by_band;
			}
		}
	if (n < p->motors) {
		notches_rest(f, p, motor);
		return;
	}
	rows_copy(f->gain + motor * harmonics * LANES, f->kept + 2u * (n - p->motors) * harmonics * LANES, harmonics);
	rows_copy(f->depth + motor * harmonics * LANES, f->kept + (2u * (n - p->motors) + 1u) * harmonics * LANES,
		  harmonics);
}
