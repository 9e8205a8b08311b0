#include "policy.h"

static const real nothing[MOTORS_MAX * LANES];

/* Motors' fractions that the model's rotors follow up to control step k. */
static const real *estimate_acting(const struct plan *p, const struct tape *t, size_t k)
{
	const size_t late = 1u + p->controller.estimator.delay;

	return k < late ? nothing : t->motors + (k - late) * p->motors * LANES;
}

static inline real estimate_target(const struct estimator *e, real command)
{
	return real_fma(real_fma(e->speed_curve[0], command, e->speed_curve[1]), command, e->speed_curve[2]);
}

static void estimate_rotors(const struct plan *p, const struct tape *t, size_t k, const real *throttle,
			    const real *told, real *restrict seen)
{
	const struct estimator *const model = &p->controller.estimator;
	const real *const acting = estimate_acting(p, t, k);
	const real *const before = k > 0 ? t->estimate + (k - 1u) * p->motors * LANES : nothing;
	real *const after = t->estimate + k * p->motors * LANES;
	const real idle = p->controller.idle;

	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const size_t i = m * LANES + l;
			const real away = estimate_target(model, acting[i]) - before[i];
			const real change = (away > R(0) ? model->rise : model->fall) * away;

			const real next = most(before[i] + limited(change, -model->loss_max, model->gain_max), R(0));

			after[i] = model->measures ? told[i] : next;
			seen[i] = after[i] - estimate_target(model, idle + (R(1) - idle) * throttle[l]);
		}
}

/* Fills in the blocks of the model's estimates at step k. */
void estimate(struct estimates *e, const struct plan *p, const struct tape *t, size_t k, const real *setpoint,
	      const real *throttle, struct sensed *s)
{
	const struct estimator *const model = &p->controller.estimator;
	const real *const gyro = s->of[BLOCK_RATE];

	estimate_rotors(p, t, k, throttle, s->of[BLOCK_ROTOR_SPEED], s->of[BLOCK_ROTOR_ESTIMATE]);
	if (k == 0)
		rows_copy(e->rate, gyro, 3);
	for (size_t j = 0; k > 0 && j < 3; ++j) {
		const real *const before = t->estimate + (k - 1u) * p->motors * LANES;
		const real *const after = t->estimate + k * p->motors * LANES;
		real *const rate = e->rate + j * LANES;

		for (size_t m = 0; m < p->motors; ++m)
			FOR_LANES(l) {
				const size_t i = m * LANES + l;

				rate[l] = real_fma(model->turn[j * p->motors + m], after[i] * after[i], rate[l]);
				rate[l] = real_fma(model->reaction[j * p->motors + m], after[i] - before[i], rate[l]);
			}
		FOR_LANES(l)
			rate[l] = real_fma(model->correction, gyro[j * LANES + l] - rate[l], rate[l]);
	}
	rows_copy(s->of[BLOCK_RATE_ESTIMATE], e->rate, 3);
	for (size_t i = 0; i < 3u * LANES; ++i)
		s->of[BLOCK_RATE_ESTIMATE_ERROR][i] = setpoint[i] - e->rate[i];
}

/* by: derivatives by what step k keeps, from later steps; becomes those by what step k - 1 keeps. Adds to those by the motors'
 * fractions, by the speeds that ESCs tell and by the gyro. */
void estimate_back(struct estimates *by, const struct plan *p, const struct tape *t, size_t k, struct sensed *by_s,
		   real *by_gyro)
{
	const struct estimator *const model = &p->controller.estimator;
	const size_t late = 1u + model->delay;
	const real *const acting = estimate_acting(p, t, k);
	const real *const before = k > 0 ? t->estimate + (k - 1u) * p->motors * LANES : nothing;
	const real *const after = t->estimate + k * p->motors * LANES;
	real *const by_acting = k < late ? NULL : t->by_motors + (k - late) * p->motors * LANES;
	const real taken = k > 0 ? model->correction : R(1);

	for (size_t i = 0; i < 3u * LANES; ++i) {
		const real by_rate = by->rate[i] + by_s->of[BLOCK_RATE_ESTIMATE][i] -
				     by_s->of[BLOCK_RATE_ESTIMATE_ERROR][i];

		by_gyro[i] += taken * by_rate;
		by->rate[i] = (R(1) - taken) * by_rate;
	}
	for (size_t m = 0; m < p->motors; ++m) {
		const real *const seen = by_s->of[BLOCK_ROTOR_ESTIMATE] + m * LANES;
		real *const by_speed = by->rotor_speed + m * LANES;

		FOR_LANES(l) {
			const size_t i = m * LANES + l;
			const real away = estimate_target(model, acting[i]) - before[i];
			const real share = away > R(0) ? model->rise : model->fall, change = share * away;
			const bool free = change > -model->loss_max && change < model->gain_max;
			const real slope = real_fma(R(2) * model->speed_curve[0], acting[i], model->speed_curve[1]);
			real turned = R(0), reacted = R(0);

			for (size_t j = 0; j < 3; ++j) {
				turned += model->turn[j * p->motors + m] * by->rate[j * LANES + l];
				reacted += model->reaction[j * p->motors + m] * by->rate[j * LANES + l];
			}
			const real by_after = by_speed[l] + seen[l] + R(2) * after[i] * turned + reacted;
			const real passed = after[i] > R(0) ? by_after : R(0);

			if (model->measures) {
				by_s->of[BLOCK_ROTOR_SPEED][i] += by_after;
				by_speed[l] = -reacted;
				continue;
			}
			by_speed[l] = passed * (free ? R(1) - share : R(1)) - reacted;
			if (by_acting != NULL)
				by_acting[i] += free ? passed * share * slope : R(0);
		}
	}
}
