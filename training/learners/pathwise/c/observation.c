#include "policy.h"

/* Rate error, its change and its integral, of setpoint and the rate that is sensed. */
void observe_error(struct observer *o, const struct controller *c, size_t k, const real *setpoint, struct sensed *s,
		   real *free)
{
	real *const rate = s->of[BLOCK_RATE], *const error = s->of[BLOCK_ERROR];
	real *const delta = s->of[BLOCK_ERROR_DELTA], *const integral = s->of[BLOCK_ERROR_INTEGRAL];

	for (size_t i = 0; i < 3u * LANES; ++i) {
		const real now = setpoint[i] - rate[i], grown = (k > 0 ? o->integral[i] : R(0)) + now * c->dt;

		delta[i] = k > 0 ? now - o->error[i] : R(0);
		error[i] = o->error[i] = now;
		integral[i] = o->integral[i] = limited(grown, -c->integral_max, c->integral_max);
		free[i] = real_abs(grown) < c->integral_max ? R(1) : R(0);
	}
}

/* by: derivatives by what step k keeps; becomes those by what step k - 1 keeps. */
void observe_error_back(struct observer *by, const struct controller *c, size_t k, const real *free, struct sensed *by_s,
			real *by_gyro)
{
	const real *const rate = by_s->of[BLOCK_RATE], *const error = by_s->of[BLOCK_ERROR];
	const real *const delta = by_s->of[BLOCK_ERROR_DELTA], *const integral = by_s->of[BLOCK_ERROR_INTEGRAL];

	for (size_t i = 0; i < 3u * LANES; ++i) {
		const real by_integral = (by->integral[i] + integral[i]) * free[i];
		const real by_delta = k > 0 ? delta[i] : R(0);

		by_gyro[i] += rate[i] - (error[i] + by->error[i] + by_delta + c->dt * by_integral);
		by->integral[i] = by_integral;
		by->error[i] = -by_delta;
	}
}

/* Low-passes and scales the terms of a step. */
void observe_terms(const struct controller *c, const struct tape *t, size_t k, const struct sensed *s)
{
	real *value = t->value + (AGE_MAX + k) * t->width * LANES, *passed = t->passed;

	for (uint32_t n = 0; n < c->terms; ++n) {
		const struct term *const term = &c->term[n];
		const real *const from = s->of[term->block];
		const real gain = k > 0 && term->gain > R(0) ? term->gain : R(1);
		const size_t count = term->width * LANES;

		for (size_t i = 0; i < count; ++i) {
			const real now = gain < R(1) ? real_fma(gain, from[i] - passed[i], passed[i]) : from[i];

			passed[i] = now;
			value[i] = now * term->scale;
		}
		value += count;
		passed += count;
	}
}

/* The network's input at step k, rows (n): each term as old as it is to be. */
const real *observed(const struct controller *c, const struct tape *t, size_t k)
{
	size_t at = 0;

	for (uint32_t n = 0; n < c->terms; ++n) {
		const struct term *const term = &c->term[n];
		const real *const seen = t->value + ((AGE_MAX + k - term->age) * t->width + at) * LANES;

		rows_copy(t->input + at * LANES, seen, term->width);
		at += term->width;
	}
	return t->input;
}

/* From derivatives by the network's inputs to those by the blocks of step k, which are added. t->passed holds those by the
 * low-passes' states. */
void observe_terms_back(const struct controller *c, const struct tape *t, size_t k, struct sensed *by)
{
	size_t at = 0;

	for (uint32_t n = 0; n < c->terms; ++n) {
		const struct term *const term = &c->term[n];
		const real *const by_value = t->by_value + ((k + term->age) * t->by_width + at) * LANES;
		const real gain = k > 0 && term->gain > R(0) ? term->gain : R(1);
		real *const passed = t->passed + at * LANES, *const to = by->of[term->block];

		for (size_t i = 0; i < term->width * LANES; ++i) {
			const real by_passed = real_fma(by_value[i], term->scale, passed[i]);

			to[i] += gain * by_passed;
			passed[i] = (R(1) - gain) * by_passed;
		}
		at += term->width;
	}
}
