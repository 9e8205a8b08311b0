/* Flies a block for an episode and goes back through the flight, step by step, to the derivatives of its loss.
 *
 * Four operations are taken as the identity there: the gyro's noise and counts, the steps of DShot, those of the words in which
 * ESCs tell rotor speeds, and the clip of the outputs, unless descent would move an output further outside. The battery's voltage is taken as constant over a sample,
 * and so is where the gyro's notches are. */
#include "aircraft.h"
#include "policy.h"

static size_t flight_samples(const struct plan *p)
{
	return (p->steps - 1u) * p->samples;
}

static void flight_layout(struct tape *t, struct arena *a, const struct plan *p)
{
	const size_t samples = flight_samples(p), fractions = p->steps * p->motors;

	t->width = p->controller.network.width[0];
	t->by_width = padded(t->width, TILE);
	layers_layout(&t->layers, a, &p->controller.network, p->steps);
	t->rotor_speed = arena_rows(a, (samples + 1u) * p->motors);
	t->rate = arena_rows(a, (samples + 1u) * 3u);
	t->ratio = p->pack.present ? arena_rows(a, samples + 1u) : NULL;
	t->value = arena_rows(a, (AGE_MAX + p->steps) * t->width);
	t->by_value = arena_rows(a, (AGE_MAX + p->steps) * t->by_width);
	t->free = arena_rows(a, p->steps * 3u);
	t->estimate = arena_rows(a, fractions);
	t->unclipped = arena_rows(a, fractions);
	t->motors = arena_rows(a, fractions);
	t->command = arena_rows(a, fractions);
	t->by_motors = arena_rows(a, fractions);
	t->notches = p->notches.harmonics > 0 ? arena_rows(a, 2u * p->notches.harmonics * (samples + 1u)) : NULL;
	t->input = arena_rows(a, padded(t->width, PART));
	t->passed = arena_rows(a, t->width);
}

/* How many numbers flight_run needs. */
size_t flight_memory(const struct plan *p)
{
	struct arena counted = {0};
	struct tape tape;

	flight_layout(&tape, &counted, p);
	return counted.used;
}

/* The sample of the tape with number n; acting is filled with the commands that act in it. */
static struct turning flight_turning(const struct plan *p, const struct block *b, const struct tape *t, size_t n,
				     real *acting, real *gained)
{
	const size_t motors = p->motors;

	for (size_t l = 0; l < LANES; ++l) {
		const size_t delay = (size_t)b->delay[l];
		const real *const given = n < delay ? NULL : t->command + (n - delay) / p->samples * motors * LANES;

		for (size_t m = 0; m < motors; ++m)
			acting[m * LANES + l] = given != NULL ? given[m * LANES + l] : R(0);
	}
	return (struct turning){.before = t->rotor_speed + n * motors * LANES,
				.after = t->rotor_speed + (n + 1u) * motors * LANES,
				.acting = acting,
				.gained = gained,
				.ratio = t->ratio != NULL ? t->ratio + n * LANES : NULL};
}

/* The moment of rotors and surroundings on the body in sample n, rows (3). */
static void flight_moment(const struct plan *p, const struct block *b, const struct turning *turning, size_t n,
			  const real *rate, real *moment)
{
	const size_t k = n / p->samples;

	rotors_moment(p, b, turning, rate, moment);
	for (size_t i = 0; b->disturbance != NULL && i < 3u * LANES; ++i)
		moment[i] += b->disturbance[3u * k * LANES + i];
}

/* From sample n to the next. */
static void flight_sample(const struct plan *p, const struct block *b, const struct tape *t, size_t n,
			  struct supply *supply, struct gyros *gyros)
{
	real acting[MOTORS_MAX * LANES], gained[MOTORS_MAX * LANES], moment[3 * LANES];
	const struct turning turning = flight_turning(p, b, t, n, acting, gained);
	const real *const rate = t->rate + n * 3u * LANES;
	real *const rate_after = t->rate + (n + 1u) * 3u * LANES;

	rotors_turn(p, b, &turning, t->rotor_speed + (n + 1u) * p->motors * LANES);
	if (p->pack.present)
		supply_step(supply, p, b, &turning, t->ratio + (n + 1u) * LANES);
	flight_moment(p, b, &turning, n, rate, moment);
	body_turn(p, moment, rate, rate_after);
	gyro_sample(gyros, p, b, n + 1u, &turning, rate_after);
}

/* Those at control step k, or at the gyro sample before it, which are 0 before the first. */
static void flight_sense_rotors(const struct plan *p, const struct tape *t, size_t k, real *told)
{
	const size_t sample = k * p->samples, late = k > 0 && p->controller.rotors_late;
	const real *const speed = t->rotor_speed + (sample - late) * p->motors * LANES;

	rotors_told(p, speed, told);
}

/* What the policy senses at control step k. action: its last output; not read at the first step. */
static void flight_sense(const struct plan *p, const struct block *b, const struct tape *t, size_t k, const real *action,
			 struct gyros *gyros, struct observer *observer, struct estimates *estimates, struct sensed *s)
{
	const size_t rows = p->motors * LANES;
	const real *const setpoint = b->setpoint + 3u * k * LANES, *const throttle = b->throttle + k * LANES;
	const real raised = R(1) / (R(1) - p->controller.idle);

	gyro_mean(gyros, p, s->of[BLOCK_RATE]);
	observe_error(observer, &p->controller, k, setpoint, s, t->free + 3u * k * LANES);
	rows_copy(s->of[BLOCK_THROTTLE], throttle, 1);
	if (p->controller.sees_rotors)
		flight_sense_rotors(p, t, k, s->of[BLOCK_ROTOR_SPEED]);
	rows_clear(s->of[BLOCK_PREVIOUS_ACTION], p->motors);
	rows_clear(s->of[BLOCK_PREVIOUS_MOTORS], p->motors);
	if (k > 0) {
		const real *const motors = t->motors + (k - 1u) * rows;

		rows_copy(s->of[BLOCK_PREVIOUS_ACTION], action, p->motors);
		for (size_t m = 0; m < p->motors; ++m)
			FOR_LANES(l)
				s->of[BLOCK_PREVIOUS_MOTORS][m * LANES + l] =
					(motors[m * LANES + l] - p->controller.idle) * raised -
					b->throttle[(k - 1u) * LANES + l];
	}
	if (p->controller.estimator.present)
		estimate(estimates, p, t, k, setpoint, throttle, s);
}

static void flight_forward(const struct plan *p, const struct block *b, const struct tape *t)
{
	const size_t rows = p->motors * LANES;
	real actions[2][MOTORS_MAX * LANES];
	struct supply supply;
	struct gyros gyros;
	struct observer observer;
	struct estimates estimates;
	struct sensed sensed;
	struct figures figures = {0};

	rows_clear(t->rotor_speed, p->motors);
	rows_clear(t->rate, 3);
	rows_clear(t->value, AGE_MAX * t->width);
	if (p->pack.present)
		supply_begin(&supply, p, b, t->ratio);
	gyro_begin(&gyros, p, b, t->rate, t->notches);
	for (size_t k = 0; k < p->steps; ++k) {
		real *const action = actions[k % 2u], *const before = actions[(k + 1u) % 2u];
		real *const unclipped = t->unclipped + k * rows;

		flight_sense(p, b, t, k, before, &gyros, &observer, &estimates, &sensed);
		observe_terms(&p->controller, t, k, &sensed);
		layers_forward(&t->layers, k, observed(&p->controller, t, k), unclipped);
		mix(p, unclipped, b->throttle + k * LANES, action, t->motors + k * rows, t->command + k * rows);
		loss_add(&figures, p, b, t, k, action, before);
		for (size_t s = 0; k + 1u < p->steps && s < p->samples; ++s)
			flight_sample(p, b, t, k * p->samples + s, &supply, &gyros);
	}
	loss_sum(&figures, b->figures);
}

/* Derivatives by the state at a sample, rows. */
struct by_state {
	real rotor_speed[MOTORS_MAX * LANES];
	real rate[3 * LANES];
};

/* From derivatives by the state after sample n to those by the state before it; adds those by the motors' fractions. */
static void flight_sample_back(const struct plan *p, const struct block *b, const struct tape *t, size_t n,
			       struct by_state *by)
{
	const size_t motors = p->motors;
	const real *const rate = t->rate + n * 3u * LANES;
	real acting[MOTORS_MAX * LANES], moment[3 * LANES], by_moment[3 * LANES], by_rate[3 * LANES];
	real by_before[MOTORS_MAX * LANES], by_acting[MOTORS_MAX * LANES], gained[MOTORS_MAX * LANES];
	const struct turning turning = flight_turning(p, b, t, n, acting, gained);
	struct by_turning by_turning = {by_before, by->rotor_speed, by_acting};

	for (size_t i = 0; i < motors * LANES; ++i)
		gained[i] = turning.after[i] - turning.before[i];
	rows_clear(by_before, motors);
	rows_clear(by_acting, motors);
	flight_moment(p, b, &turning, n, rate, moment);
	body_turn_back(p, moment, rate, by->rate, by_moment, by_rate);
	rotors_moment_back(p, b, &turning, rate, by_moment, &by_turning, by_rate);
	rotors_turn_back(p, b, &turning, &by_turning);
	rows_copy(by->rotor_speed, by_before, motors);
	rows_copy(by->rate, by_rate, 3);
	for (size_t l = 0; l < LANES; ++l) {
		const size_t delay = (size_t)b->delay[l];

		if (n < delay)
			continue;
		real *const to = t->by_motors + (n - delay) / p->samples * motors * LANES;

		for (size_t m = 0; m < motors; ++m)
			to[m * LANES + l] += by_acting[m * LANES + l];
	}
}

/* What goes back through the policy at control step k: from derivatives by the motors' fractions of that step to those by the
 * fractions and outputs before it, by the gyro and by the rotor speeds that ESCs tell. by_action: by the outputs of step k; becomes those of
 * step k - 1. */
static void flight_policy_back(const struct plan *p, const struct block *b, struct tape *t, size_t k, real *by_action,
			       struct observer *by_observer, struct estimates *by_estimates, real *by_gyro,
			       real *by_told)
{
	const size_t rows = p->motors * LANES;
	const real *const unclipped = t->unclipped + k * rows;
	real *const by_motors = t->by_motors + k * rows;
	real by_unclipped[MOTORS_MAX * LANES];
	struct sensed by;

	loss_back_action(p, b, t, k, by_action, by_motors);
	mix_back(p, unclipped, b->throttle + k * LANES, by_motors, by_action);
	clip_back(p, unclipped, by_action, by_unclipped);
	layers_backward(&t->layers, k, observed(&p->controller, t, k), by_unclipped, 
			t->by_value + k * t->by_width * LANES);
	memset(&by, 0, sizeof by);
	observe_terms_back(&p->controller, t, k, &by);
	if (p->controller.estimator.present)
		estimate_back(by_estimates, p, t, k, &by, by_gyro);
	observe_error_back(by_observer, &p->controller, k, t->free + 3u * k * LANES, &by, by_gyro);
	rows_copy(by_action, by.of[BLOCK_PREVIOUS_ACTION], p->motors);
	rows_copy(by_told, by.of[BLOCK_ROTOR_SPEED], p->motors);
	for (size_t i = 0; k > 0 && i < rows; ++i)
		by_motors[i - rows] += by.of[BLOCK_PREVIOUS_MOTORS][i] / (R(1) - p->controller.idle);
}

static void flight_backward(const struct plan *p, const struct block *b, struct tape *t)
{
	const real share = R(1) / R(p->seen);
	real by_action[MOTORS_MAX * LANES] = {0};
	struct by_state by = {0};
	struct by_gyros by_gyros = {0};
	struct observer by_observer = {0};
	struct estimates by_estimates = {0};
	real by_told[MOTORS_MAX * LANES] = {0}; /* of the control step after the samples, by the speeds that ESCs tell */

	if (p->notches.harmonics > 0)
		notches_end(&by_gyros.notches, p, flight_samples(p), t->notches);
	rows_clear(t->by_motors, p->steps * p->motors);
	rows_clear(t->by_value + p->steps * t->by_width * LANES, AGE_MAX * t->by_width);
	rows_clear(t->passed, t->width);
	for (size_t k = p->steps; k-- > 0;) {
		real by_gyro[3 * LANES] = {0};

		for (size_t s = p->samples; k + 1u < p->steps && s-- > 0;) {
			const size_t n = k * p->samples + s;

			if (s + 1u < p->samples)
				gyro_sample_back(&by_gyros, p, n + 1u, by.rate);
			flight_sample_back(p, b, t, n, &by);
			if (p->controller.rotors_late && s + 1u == p->samples)
				rows_add(by.rotor_speed, by_told, p->motors);
		}
		flight_policy_back(p, b, t, k, by_action, &by_observer, &by_estimates, by_gyro, by_told);
		if (!p->controller.rotors_late)
			rows_add(by.rotor_speed, by_told, p->motors);
		loss_back_rate(p, b, t, k, by.rate);
		for (size_t i = 0; i < 3u * LANES; ++i)
			by_gyros.by_mean[i] = share * by_gyro[i];
		gyro_sample_back(&by_gyros, p, k * p->samples, by.rate);
	}
}

static void flight_tell(const struct plan *p, const struct block *b, const struct tape *t)
{
	const size_t samples = flight_samples(p) + 1u;

	if (b->rate != NULL)
		rows_copy(b->rate, t->rate, 3u * samples);
	if (b->rotor_speed != NULL)
		rows_copy(b->rotor_speed, t->rotor_speed, p->motors * samples);
	if (b->motors != NULL)
		rows_copy(b->motors, t->motors, p->steps * p->motors);
	for (size_t k = 0; b->observation != NULL && k < p->steps; ++k)
		rows_copy(b->observation + k * t->width * LANES, observed(&p->controller, t, k), t->width);
}

/* memory: as many numbers as flight_memory says, for this call alone. */
void flight_run(const struct plan *p, const struct block *b, real *memory)
{
	struct arena arena = {.memory = memory};
	struct tape tape;

	flight_layout(&tape, &arena, p);
	layers_load(&tape.layers, b->parameters);
	flight_forward(p, b, &tape);
	flight_tell(p, b, &tape);
	if (b->gradient == NULL)
		return;
	flight_backward(p, b, &tape);
	layers_store(&tape.layers, b->gradient);
}
