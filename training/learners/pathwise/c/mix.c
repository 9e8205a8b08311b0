#include "policy.h"

/* What is added to y_i in a lane, and which outputs it depends on. */
struct lift {
	real by_all[LANES]; /* by each output, of the mean */
	real shift[LANES];
	real by_one[LANES]; /* by the output `one` */
	int32_t one[LANES];
};

static void mix_action(const struct plan *p, const real *unclipped, real *restrict action)
{
	for (size_t i = 0; i < p->motors * LANES; ++i)
		action[i] = limited(unclipped[i], R(0), R(1));
}

static void mix_extremes(const struct plan *p, const real *action, real *restrict low, real *restrict high,
			 int32_t *restrict lowest, int32_t *restrict highest)
{
	FOR_LANES(l) {
		low[l] = high[l] = action[l];
		lowest[l] = highest[l] = 0;
	}
	for (size_t m = 1; m < p->motors; ++m)
		FOR_LANES(l) {
			const real y = action[m * LANES + l];

			lowest[l] = y < low[l] ? (int32_t)m : lowest[l];
			low[l] = least(y, low[l]);
			highest[l] = y > high[l] ? (int32_t)m : highest[l];
			high[l] = most(y, high[l]);
		}
}

/* u_i = y_i + shift. attitude-first: T (1 - max y). centred: T - mean y, raised until none is below 0, or lowered until none
 * is above 1. */
static void mix_lift(const struct plan *p, const real *action, const real *throttle, struct lift *lift)
{
	real low[LANES], high[LANES], mean[LANES] = {0};
	int32_t lowest[LANES], highest[LANES];

	mix_extremes(p, action, low, high, lowest, highest);
	if (p->controller.mix == MIX_ATTITUDE_FIRST) {
		FOR_LANES(l) {
			lift->shift[l] = throttle[l] * (R(1) - high[l]);
			lift->by_all[l] = R(0);
			lift->by_one[l] = -throttle[l];
			lift->one[l] = highest[l];
		}
		return;
	}
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l)
			mean[l] += action[m * LANES + l];
	FOR_LANES(l) {
		const real centre = throttle[l] - mean[l] / R(p->motors);
		const bool raised = centre + low[l] < R(0), lowered = !raised && centre + high[l] > R(1);

		lift->shift[l] = raised ? -low[l] : lowered ? R(1) - high[l] : centre;
		lift->by_all[l] = raised || lowered ? R(0) : R(-1) / R(p->motors);
		lift->by_one[l] = raised || lowered ? R(-1) : R(0);
		lift->one[l] = raised ? lowest[l] : highest[l];
	}
}

/* action: y, within 0..1. command: motors as ESCs decode them, with the steps of DShot. Rows (M). */
void mix(const struct plan *p, const real *unclipped, const real *throttle, real *action, real *motors, real *command)
{
	const real idle = p->controller.idle;
	struct lift lift;

	mix_action(p, unclipped, action);
	mix_lift(p, action, throttle, &lift);
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const size_t i = m * LANES + l;
			const real u = limited(action[i] + lift.shift[l], R(0), R(1));
			const real raised = idle + (R(1) - idle) * u;

			motors[i] = raised;
			command[i] = p->rounded ? R((int32_t)(R(DSHOT_STEPS) * raised + R(0.5))) / R(DSHOT_STEPS) : raised;
		}
}

/* Adds to by_action what goes through the motors. The steps of DShot are taken as the identity. */
void mix_back(const struct plan *p, const real *unclipped, const real *throttle, const real *by_motors, real *by_action)
{
	const real raised = R(1) - p->controller.idle;
	real action[MOTORS_MAX * LANES], sum[LANES] = {0};
	struct lift lift;

	mix_action(p, unclipped, action);
	mix_lift(p, action, throttle, &lift);
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l)
			sum[l] += by_motors[m * LANES + l];
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const real by_shift = (lift.one[l] == (int32_t)m ? lift.by_one[l] : R(0)) + lift.by_all[l];

			by_action[m * LANES + l] += raised * (by_motors[m * LANES + l] + sum[l] * by_shift);
		}
}

/* The clip is taken as the identity, unless descent would move an output further outside. */
void clip_back(const struct plan *p, const real *unclipped, const real *by_action, real *restrict by_unclipped)
{
	for (size_t i = 0; i < p->motors * LANES; ++i) {
		const bool outwards = (unclipped[i] < R(0) && by_action[i] > R(0)) ||
				      (unclipped[i] > R(1) && by_action[i] < R(0));

		by_unclipped[i] = outwards ? R(0) : by_action[i];
	}
}
