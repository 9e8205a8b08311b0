/* The motors' sequence with the least error after a command, without a controller.
 *
 * What a motor can do in a step is to leave its rotor with a speed between two that follow from the speed before: those after the
 * least and the greatest motor value. A decision, 0..1, chooses between them. So decisions have constant limits, every motion of
 * the rotors has its decisions, and no derivative vanishes where a rotor's acceleration is at its limit.
 *
 * The search is an interior-point method: Newton's steps on the sum of errors with logarithms of the limits, whose weight falls.
 * Steps follow from the derivatives of each time step, backwards, as a linear feedback (differential dynamic programming without
 * the second derivatives of the motion). |e| counts as the least t - v log(t^2 - e^2), whose slope is e / t. */
#include "aircraft.h"

#define DEGREES R(57.29577951308232)
#define AXES 3u
#define STATES_MAX (AXES + MOTORS_MAX) /* rates, then rotor speeds */
#define INSIDE R(0.99)                 /* of the way to a limit, that a step goes at most */
#define HALVINGS 8
#define INLINE static inline __attribute__((always_inline))

/* Rows of a sequence. */
struct open_course {
	real *decision;    /* (N, M) */
	real *rotor_speed; /* (N + 1, M) [rad/s] */
	real *rate;        /* (N + 1, 3) [rad/s] */
};

struct open_tape {
	struct open_course now, tried;
	real *step;     /* (N, M), of decisions */
	real *feedback; /* (N, M, 3 + M), of decisions by states */
};

static void open_course_layout(struct open_course *c, struct arena *a, const struct plan *p, const struct open_loop *o)
{
	c->decision = arena_rows(a, o->steps * p->motors);
	c->rotor_speed = arena_rows(a, (o->steps + 1u) * p->motors);
	c->rate = arena_rows(a, (o->steps + 1u) * AXES);
}

static void open_layout(struct open_tape *t, struct arena *a, const struct plan *p, const struct open_loop *o)
{
	open_course_layout(&t->now, a, p, o);
	open_course_layout(&t->tried, a, p, o);
	t->step = arena_rows(a, o->steps * p->motors);
	t->feedback = arena_rows(a, o->steps * p->motors * (AXES + p->motors));
}

/* How many numbers open_loop_run needs. */
size_t open_loop_memory(const struct plan *p, const struct open_loop *o)
{
	struct arena counted = {0};
	struct open_tape tape;

	open_layout(&tape, &counted, p, o);
	return counted.used;
}

/* ---- a step of time ---- */

/* Change of a rotor's speed after a motor value, and its derivative by the speed. */
INLINE real open_reach(const struct plan *p, const struct block *b, size_t l, real away, real *slope)
{
	const real first = b->response[l], second = b->response[LANES + l], third = b->response[2 * LANES + l];
	const real share = !p->propulsion.limited && away <= R(0) ? second : first, change = share * away;
	const bool held = p->propulsion.limited && (change <= -third || change >= second);

	*slope = held ? R(0) : -share;
	return p->propulsion.limited ? limited(change, -third, second) : change;
}

/* Changes of a rotor's speed that motors can choose from, and their derivatives by the speed. */
struct open_range {
	real least, span, slope, slope_span;
};

INLINE struct open_range open_range_of(const struct plan *p, const struct block *b, const struct open_loop *o, size_t l,
				       real speed)
{
	struct open_range r;

	r.least = open_reach(p, b, l, o->lowest[l] - speed, &r.slope);
	r.span = open_reach(p, b, l, o->highest[l] - speed, &r.slope_span) - r.least;
	r.slope_span -= r.slope;
	return r;
}

/* Rows (M) that the moment of a step follows from. */
struct open_rotors {
	real middle[MOTORS_MAX * LANES], gained[MOTORS_MAX * LANES];
};

static struct turning open_turning(const struct plan *p, const struct open_loop *o, const struct open_course *c, size_t n,
				   struct open_rotors *r)
{
	const real *const before = c->rotor_speed + n * p->motors * LANES, *const after = before + p->motors * LANES;

	for (size_t i = 0; i < p->motors * LANES; ++i) {
		r->gained[i] = after[i] - before[i];
		r->middle[i] = real_fma(o->middle, r->gained[i], before[i]);
	}
	return (struct turning){.before = before, .after = r->middle, .gained = r->gained};
}

static void open_advance(const struct plan *p, const struct block *b, const struct open_loop *o, const struct open_course *c,
			 size_t n)
{
	const size_t rows = p->motors * LANES;
	const real *const decision = c->decision + n * rows, *const before = c->rotor_speed + n * rows;
	const real *const rate = c->rate + n * AXES * LANES;
	real *const after = c->rotor_speed + (n + 1u) * rows;
	real moment[AXES * LANES];
	struct open_rotors rotors;

	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const size_t i = m * LANES + l;
			const struct open_range r = open_range_of(p, b, o, l, before[i]);

			after[i] = before[i] + real_fma(decision[i], r.span, r.least);
		}
	const struct turning turning = open_turning(p, o, c, n, &rotors);

	rotors_moment(p, b, &turning, rate, moment);
	body_turn(p, moment, rate, c->rate + (n + 1u) * AXES * LANES);
}

/* Derivatives of the states after a step. Rows: of the rates by rates, by rotor speeds and by decisions, (3, 3), (3, M) and (3, M); of
 * the rotor speeds by themselves and by decisions, (M). */
struct open_slopes {
	real rate[AXES * AXES * LANES], speed[AXES * MOTORS_MAX * LANES], decision[AXES * MOTORS_MAX * LANES];
	real kept[MOTORS_MAX * LANES], span[MOTORS_MAX * LANES];
};

static void open_slopes_find(const struct plan *p, const struct block *b, const struct open_loop *o, const struct open_course *c,
			     size_t n, struct open_slopes *s)
{
	const size_t rows = p->motors * LANES;
	const real *const rate = c->rate + n * AXES * LANES, *const decision = c->decision + n * rows;
	struct open_rotors rotors;
	const struct turning turning = open_turning(p, o, c, n, &rotors);
	real moment[AXES * LANES];

	for (size_t m = 0; m < p->motors; ++m)
		FOR_LANES(l) {
			const size_t i = m * LANES + l;
			const struct open_range r = open_range_of(p, b, o, l, turning.before[i]);

			s->kept[i] = R(1) + real_fma(decision[i], r.slope_span, r.slope);
			s->span[i] = r.span;
		}
	rotors_moment(p, b, &turning, rate, moment);
	for (size_t j = 0; j < AXES; ++j) {
		real by_after[AXES * LANES] = {0}, by_moment[AXES * LANES];
		real by_before[MOTORS_MAX * LANES] = {0}, by_middle[MOTORS_MAX * LANES] = {0};
		struct by_turning by = {.before = by_before, .after = by_middle};

		FOR_LANES(l)
			by_after[j * LANES + l] = R(1);
		body_turn_back(p, moment, rate, by_after, by_moment, s->rate + j * AXES * LANES);
		rotors_moment_back(p, b, &turning, rate, by_moment, &by, s->rate + j * AXES * LANES);
		/* The reaction's part of by_middle is by the speed after the step, all else by the one in its middle. */
		for (size_t i = 0; i < rows; ++i) {
			const real by_gained = -by_before[i], by_load = by_middle[i] - by_gained;
			const real by_next = real_fma(o->middle, by_load, by_gained);
			const real by_kept = real_fma(R(1) - o->middle, by_load, -by_gained);

			s->decision[j * rows + i] = by_next * s->span[i];
			s->speed[j * rows + i] = real_fma(by_next, s->kept[i], by_kept);
		}
	}
}

/* ---- what counts ---- */

INLINE real open_error(const struct open_loop *o, const real *rate, size_t i)
{
	return (o->wanted[i] - rate[i]) * DEGREES;
}

/* Of an error that counts a third: what counts, its slope and its curvature, by the error. */
struct open_cost {
	real value, slope, curvature;
};

INLINE struct open_cost open_cost_of(const struct open_loop *o, real error, real barrier)
{
	const real share = R(1) / R(3);

	if (o->squared)
		return (struct open_cost){share * error * error, R(2) * share * error, R(2) * share};
	const real soft = barrier / share, length = real_sqrt(soft * soft + error * error), top = soft + length;

	return (struct open_cost){share * length, share * error / top, barrier / (length * top)};
}

/* Sum that Newton's steps lessen, of each lane. */
static void open_merit(const struct plan *p, const struct open_loop *o, const struct open_course *c, const real *barrier,
		       double *merit)
{
	for (size_t l = 0; l < LANES; ++l)
		merit[l] = 0.0;
	for (size_t n = 0; n < o->steps; ++n) {
		const real *const rate = c->rate + (n + 1u) * AXES * LANES, *const q = c->decision + n * p->motors * LANES;
		real inside[LANES];

		for (size_t j = 0; j < AXES; ++j)
			FOR_LANES(l) {
				const struct open_cost cost =
					open_cost_of(o, open_error(o, rate, j * LANES + l), barrier[l]);

				merit[l] += (double)cost.value;
				/* t - v log(t^2 - e^2) less constants: t^2 - e^2 = 2 v t. */
				inside[l] = o->squared ? R(1) :
							 (j == 0 ? R(1) : inside[l]) *
								 (R(3) * (cost.value + barrier[l]));
			}
		for (size_t m = 0; m < p->motors; ++m)
			FOR_LANES(l)
				inside[l] *= q[m * LANES + l] * (R(1) - q[m * LANES + l]);
		for (size_t l = 0; l < LANES; ++l)
			merit[l] -= (double)barrier[l] * log((double)inside[l]);
	}
}

/* ---- backwards: Newton's step ---- */

/* Value of the states that a step leads to: slopes (X) and curvatures (X, X), rows. */
struct open_value {
	real slope[STATES_MAX * LANES], curvature[STATES_MAX * STATES_MAX * LANES];
};

/* Adds what the error after step n counts. */
static void open_value_add(const struct plan *p, const struct open_loop *o, const struct open_course *c, size_t n,
			   const real *barrier, struct open_value *v)
{
	const size_t states = AXES + p->motors;
	const real *const rate = c->rate + (n + 1u) * AXES * LANES;

	for (size_t j = 0; j < AXES; ++j)
		FOR_LANES(l) {
			const struct open_cost cost = open_cost_of(o, open_error(o, rate, j * LANES + l), barrier[l]);

			v->slope[j * LANES + l] -= DEGREES * cost.slope;
			v->curvature[j * (states + 1u) * LANES + l] += DEGREES * DEGREES * cost.curvature;
		}
}

/* to (count, X) = from (count, X) times the derivatives of the states by the states before. */
static void open_by_states(const struct plan *p, const struct open_slopes *s, size_t count, const real *restrict from,
			   real *restrict to)
{
	const size_t motors = p->motors, states = AXES + motors;

	for (size_t i = 0; i < count; ++i) {
		const real *const of = from + i * states * LANES;
		real *const by = to + i * states * LANES;

		for (size_t k = 0; k < AXES; ++k)
			FOR_LANES(l)
				by[k * LANES + l] = of[l] * s->rate[k * LANES + l] +
						    of[LANES + l] * s->rate[(AXES + k) * LANES + l] +
						    of[2 * LANES + l] * s->rate[(2 * AXES + k) * LANES + l];
		for (size_t m = 0; m < motors; ++m)
			FOR_LANES(l)
				by[(AXES + m) * LANES + l] = of[(AXES + m) * LANES + l] * s->kept[m * LANES + l] +
							     of[l] * s->speed[m * LANES + l] +
							     of[LANES + l] * s->speed[(motors + m) * LANES + l] +
							     of[2 * LANES + l] * s->speed[(2 * motors + m) * LANES + l];
	}
}

/* to (count, M): likewise by the decisions. */
static void open_by_decisions(const struct plan *p, const struct open_slopes *s, size_t count, const real *restrict from,
			      real *restrict to)
{
	const size_t motors = p->motors, states = AXES + motors;

	for (size_t i = 0; i < count; ++i)
		for (size_t m = 0; m < motors; ++m)
			FOR_LANES(l) {
				const real *const of = from + i * states * LANES + l;

				to[(i * motors + m) * LANES + l] =
					of[(AXES + m) * LANES] * s->span[m * LANES + l] + of[0] * s->decision[m * LANES + l] +
					of[LANES] * s->decision[(motors + m) * LANES + l] +
					of[2 * LANES] * s->decision[(2 * motors + m) * LANES + l];
			}
}

static void open_transpose(size_t rows, size_t columns, const real *restrict from, real *restrict to)
{
	for (size_t i = 0; i < rows; ++i)
		for (size_t j = 0; j < columns; ++j)
			rows_copy(to + (j * rows + i) * LANES, from + (i * columns + j) * LANES, 1);
}

/* Cholesky's factor of a symmetric matrix (size, size), in place of its lower half; its diagonal is inverted. */
static void open_factor(size_t size, real *a)
{
	for (size_t i = 0; i < size; ++i)
		for (size_t j = 0; j <= i; ++j) {
			real *const at = a + (i * size + j) * LANES;

			for (size_t k = 0; k < j; ++k)
				FOR_LANES(l)
					at[l] -= a[(i * size + k) * LANES + l] * a[(j * size + k) * LANES + l];
			FOR_LANES(l)
				at[l] = i == j ? R(1) / real_sqrt(at[l]) : at[l] * a[(j * size + j) * LANES + l];
		}
}

/* Solves for `count` columns of x (size, count), in place. */
static void open_solve(size_t size, const real *a, size_t count, real *x)
{
	for (size_t i = 0; i < size; ++i)
		for (size_t c = 0; c < count; ++c) {
			real *const at = x + (i * count + c) * LANES;

			for (size_t k = 0; k < i; ++k)
				FOR_LANES(l)
					at[l] -= a[(i * size + k) * LANES + l] * x[(k * count + c) * LANES + l];
			FOR_LANES(l)
				at[l] *= a[(i * size + i) * LANES + l];
		}
	for (size_t i = size; i-- > 0;)
		for (size_t c = 0; c < count; ++c) {
			real *const at = x + (i * count + c) * LANES;

			for (size_t k = i + 1u; k < size; ++k)
				FOR_LANES(l)
					at[l] -= a[(k * size + i) * LANES + l] * x[(k * count + c) * LANES + l];
			FOR_LANES(l)
				at[l] *= a[(i * size + i) * LANES + l];
		}
}

/* Newton's step of the decisions n, and the value before them. */
static void open_decide(const struct plan *p, const struct open_tape *t, const struct open_slopes *s, size_t n,
			const real *barrier, struct open_value *v)
{
	const size_t motors = p->motors, states = AXES + motors;
	const real *const q = t->now.decision + n * motors * LANES;
	real *const step = t->step + n * motors * LANES, *const feedback = t->feedback + n * motors * states * LANES;
	real half[STATES_MAX * STATES_MAX * LANES], turned[STATES_MAX * STATES_MAX * LANES];
	real by_both[MOTORS_MAX * STATES_MAX * LANES], matrix[MOTORS_MAX * MOTORS_MAX * LANES];
	real by_decision[MOTORS_MAX * LANES], slope[STATES_MAX * LANES];

	open_by_decisions(p, s, 1, v->slope, by_decision);
	open_by_states(p, s, 1, v->slope, slope);
	open_by_decisions(p, s, states, v->curvature, half);
	open_transpose(states, motors, half, turned);
	open_by_decisions(p, s, motors, turned, matrix);
	open_by_states(p, s, motors, turned, by_both);
	open_by_states(p, s, states, v->curvature, half);
	open_transpose(states, states, half, turned);
	open_by_states(p, s, states, turned, v->curvature);
	for (size_t m = 0; m < motors; ++m)
		FOR_LANES(l) {
			const size_t i = m * LANES + l;
			const real low = R(1) / q[i], high = R(1) / (R(1) - q[i]);

			step[i] = barrier[l] * (low - high) - by_decision[i];
			matrix[m * (motors + 1u) * LANES + l] += barrier[l] * (low * low + high * high);
		}
	open_factor(motors, matrix);
	open_solve(motors, matrix, 1, step);
	for (size_t i = 0; i < motors * states * LANES; ++i)
		feedback[i] = -by_both[i];
	open_solve(motors, matrix, states, feedback);
	for (size_t i = 0; i < states; ++i) {
		for (size_t m = 0; m < motors; ++m)
			FOR_LANES(l)
				slope[i * LANES + l] += by_both[(m * states + i) * LANES + l] * step[m * LANES + l];
		for (size_t j = 0; j < states; ++j)
			for (size_t m = 0; m < motors; ++m)
				FOR_LANES(l)
					v->curvature[(i * states + j) * LANES + l] +=
						by_both[(m * states + i) * LANES + l] *
						feedback[(m * states + j) * LANES + l];
	}
	rows_copy(v->slope, slope, states);
}

static void open_newton(const struct plan *p, const struct block *b, const struct open_loop *o, const struct open_tape *t,
			const real *barrier)
{
	struct open_value value = {0};
	struct open_slopes slopes;

	for (size_t n = o->steps; n-- > 0;) {
		open_value_add(p, o, &t->now, n, barrier, &value);
		open_slopes_find(p, b, o, &t->now, n, &slopes);
		open_decide(p, t, &slopes, n, barrier, &value);
	}
}

/* ---- forwards ---- */

/* The sequence that `share` of Newton's step leads to. */
static void open_try(const struct plan *p, const struct block *b, const struct open_loop *o, const struct open_tape *t,
		     const real *share)
{
	const size_t motors = p->motors, states = AXES + motors, rows = motors * LANES;

	for (size_t n = 0; n < o->steps; ++n) {
		const real *const rate = t->tried.rate + n * AXES * LANES, *const rate_now = t->now.rate + n * AXES * LANES;
		const real *const speed = t->tried.rotor_speed + n * rows, *const speed_now = t->now.rotor_speed + n * rows;
		real away[STATES_MAX * LANES];

		for (size_t i = 0; i < AXES * LANES; ++i)
			away[i] = rate[i] - rate_now[i];
		for (size_t i = 0; i < rows; ++i)
			away[AXES * LANES + i] = speed[i] - speed_now[i];
		for (size_t m = 0; m < motors; ++m)
			FOR_LANES(l) {
				const size_t i = n * rows + m * LANES + l;
				const real q = t->now.decision[i];
				real change = share[l] * t->step[i];

				for (size_t k = 0; k < states; ++k)
					change = real_fma(t->feedback[(n * motors + m) * states * LANES + k * LANES + l],
							  away[k * LANES + l], change);
				t->tried.decision[i] = q + limited(change, -INSIDE * q, INSIDE * (R(1) - q));
			}
		open_advance(p, b, o, &t->tried, n);
	}
}

static void open_start(const struct plan *p, const struct block *b, const struct open_loop *o, const struct open_tape *t)
{
	const struct open_course *const courses[] = {&t->now, &t->tried};

	for (size_t i = 0; i < 2; ++i) {
		rows_copy(courses[i]->rotor_speed, o->rotor_speed, p->motors);
		rows_copy(courses[i]->rate, o->rate, AXES);
	}
	rows_copy(t->now.decision, o->decision, o->steps * p->motors);
	for (size_t n = 0; n < o->steps; ++n)
		open_advance(p, b, o, &t->now, n);
}

static void open_iterate(const struct plan *p, const struct block *b, const struct open_loop *o, struct open_tape *t,
			 const real *barrier)
{
	double now[LANES], tried[LANES];
	real share[LANES];
	bool worse = true;

	open_newton(p, b, o, t, barrier);
	open_merit(p, o, &t->now, barrier, now);
	FOR_LANES(l)
		share[l] = R(1);
	for (uint32_t i = 0; i <= HALVINGS && worse; ++i) {
		open_try(p, b, o, t, share);
		open_merit(p, o, &t->tried, barrier, tried);
		worse = false;
		for (size_t l = 0; l < LANES; ++l)
			if (!(tried[l] <= now[l])) { /* no number is worse too */
				share[l] = i + 1u < HALVINGS ? share[l] / R(2) : R(0);
				worse = worse || share[l] > R(0) || i + 1u == HALVINGS;
			}
	}
	const struct open_course kept = t->now;

	t->now = t->tried;
	t->tried = kept;
}

/* ---- what was found ---- */

/* Sums of errors, and a sum that no sequence is below if the error after each step is linear in the decisions: by the slopes of what
 * counts, no decision can gain more than at its limits. */
static void open_tell(const struct plan *p, const struct block *b, const struct open_loop *o, const struct open_tape *t,
		      const real *barrier)
{
	const size_t rows = p->motors * LANES;
	real slope[STATES_MAX * LANES] = {0}, before[STATES_MAX * LANES], by_decision[MOTORS_MAX * LANES];
	struct open_slopes slopes;

	for (size_t i = 0; i < 4u * LANES; ++i)
		o->figures[i] = 0.0;
	for (size_t n = o->steps; n-- > 0;) {
		const real *const rate = t->now.rate + (n + 1u) * AXES * LANES, *const q = t->now.decision + n * rows;

		for (size_t j = 0; j < AXES; ++j)
			for (size_t l = 0; l < LANES; ++l) {
				const real error = open_error(o, rate, j * LANES + l);
				const struct open_cost cost = open_cost_of(o, error, barrier[l]);

				o->figures[l] += (double)(real_abs(error) / R(3));
				o->figures[LANES + l] += (double)(error * error / R(3));
				o->figures[2 * LANES + l] += n + 1u == o->steps ? (double)(real_abs(error) / R(3)) : 0.0;
				o->figures[3 * LANES + l] += (double)(o->squared ? cost.value : cost.slope * error);
				slope[j * LANES + l] -= DEGREES * cost.slope;
			}
		open_slopes_find(p, b, o, &t->now, n, &slopes);
		open_by_decisions(p, &slopes, 1, slope, by_decision);
		open_by_states(p, &slopes, 1, slope, before);
		rows_copy(slope, before, AXES + p->motors);
		for (size_t i = 0; i < rows; ++i)
			o->figures[3 * LANES + i % LANES] -=
				(double)most(by_decision[i] * q[i], -by_decision[i] * (R(1) - q[i]));
		if (o->gradient != NULL)
			rows_copy(o->gradient + n * rows, by_decision, p->motors);
	}
}

/* Of the block only response and the factors of moments are read. memory: as many numbers as open_loop_memory says, for this call
 * alone. */
void open_loop_run(const struct plan *p, const struct block *b, const struct open_loop *o, real *memory)
{
	struct arena arena = {.memory = memory};
	struct open_tape tape;
	real barrier[LANES];
	const real fall = o->iterations > 1u ? (real)pow((double)(o->barrier[1] / o->barrier[0]),
							 1.0 / (double)(o->iterations - 1u)) :
					       R(1);

	open_layout(&tape, &arena, p, o);
	open_start(p, b, o, &tape);
	FOR_LANES(l)
		barrier[l] = o->barrier[o->iterations > 0 ? 0 : 1] * o->scale[l];
	for (uint32_t i = 0; i < o->iterations; ++i) {
		open_iterate(p, b, o, &tape, barrier);
		for (size_t l = 0; l < LANES && i + 1u < o->iterations; ++l)
			barrier[l] *= fall;
	}
	open_tell(p, b, o, &tape, barrier);
	rows_copy(o->decision, tape.now.decision, o->steps * p->motors);
	if (o->rate_after != NULL)
		rows_copy(o->rate_after, tape.now.rate + AXES * LANES, AXES * o->steps);
	if (o->speed_after != NULL)
		rows_copy(o->speed_after, tape.now.rotor_speed + p->motors * LANES, p->motors * o->steps);
}
