/* Flies a block with a PID: rotors, bodies, gyros and mix are those of the policies' flights. The law and its float32 numbers
 * are those of the firmware's pid.c, which has one aircraft in a struct and its number of motors as a constant, where LANES of
 * them lie side by side here. */
#include "aircraft.h"
#include "policy.h"

struct craft {
	real rotor_speed[2][MOTORS_MAX * LANES]; /* [rad/s], rows, before and after a sample in turn */
	real rate[2][3 * LANES];                 /* [rad/s], likewise */
	real command[COMMANDS_KEPT][MOTORS_MAX * LANES];
};

struct pid {
	real integral[3 * LANES]; /* [rad] */
	real slope[3 * LANES];    /* [rad/s^2], low-passed */
	real before[3 * LANES];   /* [rad/s], gyro of the control step before */
};

/* What is asked of each axis, rows (3). */
static void pid_axes(struct pid *pid, const struct plan *p, const struct pid_trial *t, const real *setpoint, const real *gyro,
		     bool first, real *restrict axes)
{
	const real dt = p->controller.dt;

	for (size_t j = 0; j < 3; ++j)
		FOR_LANES(l) {
			const size_t at = j * LANES + l;
			const real error = setpoint[at] - gyro[at];
			const real slope = first ? R(0) : (gyro[at] - pid->before[at]) / dt;
			const real integral = pid->integral[at] + error * dt;

			pid->slope[at] += t->smoothing * (slope - pid->slope[at]);
			pid->before[at] = gyro[at];
			pid->integral[at] = limited(integral, -t->integral_max[j], t->integral_max[j]);
			axes[at] = t->p[j] * error + t->i[j] * pid->integral[at] - t->d[j] * pid->slope[at];
		}
}

/* Outputs, rows (M): demands lifted until none is below 0, narrowed where they span more than 1; mix() cuts them at 1. */
static void pid_outputs(const struct plan *p, const struct pid_trial *t, const real *axes, real *restrict y)
{
	real low[LANES], high[LANES];

	for (size_t m = 0; m < p->motors; ++m) {
		const real *const share = t->mixer + 3u * m;

		FOR_LANES(l) {
			const real demand = share[0] * axes[l] + share[1] * axes[LANES + l] + share[2] * axes[2 * LANES + l];

			y[m * LANES + l] = demand;
			low[l] = m == 0 ? demand : least(low[l], demand);
			high[l] = m == 0 ? demand : most(high[l], demand);
		}
	}
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l)
			y[m * LANES + l] = (y[m * LANES + l] - least(low[l], R(0))) / most(high[l] - low[l], R(1));
}

/* From sample n to the next. */
static void pid_sample(const struct plan *p, const struct block *b, const struct pid_trial *t, struct craft *c,
		       struct gyros *gyros, size_t n)
{
	real acting[MOTORS_MAX * LANES], gained[MOTORS_MAX * LANES], moment[3 * LANES];
	const real *const rate = c->rate[n % 2u];
	real *const turned = c->rotor_speed[(n + 1u) % 2u], *const rate_after = c->rate[(n + 1u) % 2u];
	const struct turning turning = {
		.before = c->rotor_speed[n % 2u], .after = turned, .acting = acting, .gained = gained};

	for (size_t l = 0; l < LANES; ++l) {
		const size_t delay = (size_t)b->delay[l];
		const real *const given = n < delay ? NULL : c->command[(n - delay) / p->samples % COMMANDS_KEPT];

		for (size_t m = 0; m < p->motors; ++m)
			acting[m * LANES + l] = given != NULL ? given[m * LANES + l] : R(0);
	}
	rotors_turn(p, b, &turning, turned);
	rotors_moment(p, b, &turning, rate, moment);
	for (size_t i = 0; i < 3u * LANES; ++i)
		moment[i] += t->moment[i];
	body_turn(p, moment, rate, rate_after);
	gyro_sample(gyros, p, b, n + 1u, &turning, rate_after);
}

static void pid_count(const struct plan *p, const real *setpoint, const real *rate, const real *command,
		      const real *before, real *restrict figures)
{
	for (size_t i = 0; i < 3u * LANES; ++i) {
		const real error = setpoint[i] - rate[i];

		figures[i] += real_abs(error);
		figures[3u * LANES + i] += error * error;
	}
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l)
			figures[6 * LANES + l] += real_abs(command[m * LANES + l] - before[m * LANES + l]) / R(p->motors);
}

void pid_trial_run(const struct plan *p, const struct block *b, const struct pid_trial *trial, real *figures)
{
	struct craft craft = {0};
	struct pid pid = {0};
	struct gyros gyros;
	real gyro[3 * LANES], axes[3 * LANES];
	real y[MOTORS_MAX * LANES], action[MOTORS_MAX * LANES], motors[MOTORS_MAX * LANES];

	rows_clear(figures, 7);
	gyro_begin(&gyros, p, b, craft.rate[0], NULL);
	for (size_t k = 0; k < p->steps; ++k) {
		const real *const setpoint = b->setpoint + 3u * k * LANES;
		real *const command = craft.command[k % COMMANDS_KEPT];

		gyro_mean(&gyros, p, gyro);
		pid_axes(&pid, p, trial, setpoint, gyro, k == 0, axes);
		pid_outputs(p, trial, axes, y);
		mix(p, y, b->throttle + k * LANES, action, motors, command);
		if (k >= trial->begin)
			pid_count(p, setpoint, craft.rate[k * p->samples % 2u], command,
				  craft.command[(k - 1u) % COMMANDS_KEPT], figures);
		for (size_t s = 0; k + 1u < p->steps && s < p->samples; ++s)
			pid_sample(p, b, trial, &craft, &gyros, k * p->samples + s);
	}
	for (size_t i = 0; i < 7u * LANES; ++i)
		figures[i] /= R(p->steps - trial->begin);
}
