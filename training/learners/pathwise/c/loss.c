#include "policy.h"

#define DEGREES R(57.29577951308232)

/* Whose change has a weight: the motors, or the outputs as far as they are not clipped. */
static inline real loss_changing(const struct plan *p, const struct tape *t, size_t at)
{
	return p->loss.of_motors ? t->motors[at] : limited(t->unclipped[at], R(0), R(1));
}

/* |error|, rounded off where it is small: sqrt(error^2 + soft^2) - soft. */
static inline real size_of(real error, real soft)
{
	return real_sqrt(error * error + soft * soft) - soft;
}

/* Its derivative. */
static inline real slope_of(real error, real soft)
{
	const real length = real_sqrt(error * error + soft * soft);

	return length > R(0) ? error / length : R(0);
}

static inline real sign_of(real value)
{
	return value > R(0) ? R(1) : value < R(0) ? R(-1) : R(0);
}

/* action_before is not read at the first step. */
void loss_add(struct figures *f, const struct plan *p, const struct block *b, const struct tape *t, size_t k,
	      const real *action, const real *action_before)
{
	const real *const absolute = b->absolute + k * LANES, *const squared = b->squared + k * LANES;
	const real *const effort = b->effort + k * LANES, *const closed = b->closed + k * LANES;
	const real *const setpoint = b->setpoint + 3u * k * LANES;
	const real *const rate = t->rate + 3u * k * p->samples * LANES;
	const size_t row = k * p->motors * LANES, before = k > 0 ? row - p->motors * LANES : row;
	const real axis = R(1) / R(3), motor = R(1) / R(p->motors), scale = p->loss.change_scale * motor;
	const real *const now = p->loss.of_motors ? t->motors + row : action;
	const real *const then = p->loss.of_motors ? t->motors + before : k > 0 ? action_before : action;
	const real raised = R(1) / (R(1) - p->controller.idle);

	for (size_t j = 0; j < 3; ++j)
		FOR_LANES(l) {
			const real error = (setpoint[j * LANES + l] - rate[j * LANES + l]) * DEGREES;

			f->of[FIGURE_MAE][l] += (double)(absolute[l] * axis * size_of(error, p->loss.soft));
			f->of[FIGURE_MSE][l] += (double)(squared[l] * axis * error * error);
		}
	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const size_t i = m * LANES + l;
			const real turning = (t->motors[row + i] - p->controller.idle) * raised;

			f->of[FIGURE_OUTPUT][l] += (double)(effort[l] * motor * action[i]);
			f->of[FIGURE_CHANGE][l] += (double)(effort[l] * scale * real_abs(now[i] - then[i]));
			f->of[FIGURE_CLOSED][l] += (double)(closed[l] * motor * turning);
		}
}

void loss_sum(const struct figures *f, double *figures)
{
	for (size_t i = 0; i < FIGURES; ++i) {
		figures[i] = 0.0;
		for (size_t l = 0; l < LANES; ++l)
			figures[i] += f->of[i][l];
	}
}

/* Adds the derivatives by the rate of control step k. */
void loss_back_rate(const struct plan *p, const struct block *b, const struct tape *t, size_t k, real *by_rate)
{
	const real *const absolute = b->absolute + k * LANES, *const squared = b->squared + k * LANES;
	const real *const setpoint = b->setpoint + 3u * k * LANES;
	const real *const rate = t->rate + 3u * k * p->samples * LANES;
	const real axis = DEGREES / R(3), square = R(2) * p->loss.square;

	for (size_t j = 0; j < 3; ++j)
		FOR_LANES(l) {
			const real error = (setpoint[j * LANES + l] - rate[j * LANES + l]) * DEGREES;

			by_rate[j * LANES + l] -=
				axis * (absolute[l] * slope_of(error, p->loss.soft) + square * squared[l] * error);
		}
}

/* Adds the derivatives by outputs and motors of control step k. */
void loss_back_action(const struct plan *p, const struct block *b, const struct tape *t, size_t k, real *by_action,
		      real *by_motors)
{
	const real *const effort = b->effort + k * LANES, *const closed = b->closed + k * LANES;
	const bool first = k == 0, last = k + 1u == p->steps;
	const real *const later = last ? effort : effort + LANES; /* of the change from this step to the next */
	const size_t row = k * p->motors * LANES, rows = p->motors * LANES;
	const real motor = R(1) / R(p->motors), change = p->loss.change * p->loss.change_scale * motor;
	const real closing = p->loss.closed * motor / (R(1) - p->controller.idle);
	real *const by_changing = p->loss.of_motors ? by_motors : by_action;

	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const size_t i = m * LANES + l, at = row + i;
			const real now = loss_changing(p, t, at);
			const real before = first ? now : loss_changing(p, t, at - rows);
			const real after = last ? now : loss_changing(p, t, at + rows);

			by_changing[i] += change * (effort[l] * sign_of(now - before) - later[l] * sign_of(after - now));
			by_action[i] += p->loss.output * effort[l] * motor;
			by_motors[i] += closing * closed[l];
		}
}
