#include "aircraft.h"

static void polynomial_row(const struct polynomial *p, const real *restrict at, real *restrict value)
{
	FOR_LANES(l)
		value[l] = p->term[p->terms - 1u];
	for (uint32_t i = p->terms - 1u; i-- > 0u;)
		FOR_LANES(l)
			value[l] = real_fma(value[l], at[l], p->term[i]);
}

static void polynomial_slope_row(const struct polynomial *p, const real *restrict at, real *restrict slope)
{
	FOR_LANES(l)
		slope[l] = R(0);
	for (uint32_t i = p->terms; i-- > 1u;)
		FOR_LANES(l)
			slope[l] = real_fma(slope[l], at[l], R(i) * p->term[i]);
}

/* Thrust [N] of a rotor, and the ratio of its drag torque to it [m]. */
void rotor_loads(const struct propulsion *p, const real *restrict speed, real *restrict thrust, real *restrict ratio)
{
	polynomial_row(&p->thrust, speed, thrust);
	polynomial_row(&p->torque, speed, ratio);
	FOR_LANES(l)
		thrust[l] *= speed[l] * speed[l];
}

static inline real rotor_target(const struct propulsion *p, real command)
{
	return real_fma(real_fma(p->speed_curve[0], command, p->speed_curve[1]), command, p->speed_curve[2]);
}

/* Factor of the speed that a command of rotor m settles at. */
static void rotor_factor(const struct block *b, const real *ratio, size_t m, real *restrict factor)
{
	const real *const speed = b->speed + m * LANES;

	FOR_LANES(l)
		factor[l] = ratio != NULL ? speed[l] * ratio[l] : speed[l];
}

void rotors_turn(const struct plan *p, const struct block *b, const struct turning *t, real *restrict after)
{
	const struct propulsion *const own = &p->propulsion;
	const real *const first = b->response, *const second = first + LANES, *const third = second + LANES;
	real factor[LANES];

	for (size_t m = 0; m < p->motors; ++m) {
		const real *const acting = t->acting + m * LANES, *const before = t->before + m * LANES;
		real *const next = after + m * LANES, *const gained = t->gained + m * LANES;

		rotor_factor(b, t->ratio, m, factor);
		FOR_LANES(l) {
			const real away = rotor_target(own, acting[l]) * factor[l] - before[l];
			const real change = own->limited ? limited(first[l] * away, -third[l], second[l]) :
							   (away > R(0) ? first[l] : second[l]) * away;

			gained[l] = most(change, -before[l]);
			next[l] = most(before[l] + change, R(0));
		}
	}
}

/* Adds to by->before and by->acting what goes through by->after. The voltage is taken as constant over the sample. */
void rotors_turn_back(const struct plan *p, const struct block *b, const struct turning *t, struct by_turning *by)
{
	const struct propulsion *const own = &p->propulsion;
	const real *const first = b->response, *const second = first + LANES, *const third = second + LANES;
	real factor[LANES];

	for (size_t m = 0; m < p->motors; ++m) {
		const real *const acting = t->acting + m * LANES, *const before = t->before + m * LANES;
		const real *const after = t->after + m * LANES;
		const real *const by_after = by->after + m * LANES;
		real *const by_before = by->before + m * LANES, *const by_acting = by->acting + m * LANES;

		rotor_factor(b, t->ratio, m, factor);
		FOR_LANES(l) {
			const real away = rotor_target(own, acting[l]) * factor[l] - before[l];
			const real change = first[l] * away;
			const bool free = change > -third[l] && change < second[l];
			const real share = own->limited ? (free ? first[l] : R(0)) :
							  (away > R(0) ? first[l] : second[l]);
			const real turns = after[l] > R(0) ? by_after[l] : R(0);
			const real slope = real_fma(R(2) * own->speed_curve[0], acting[l], own->speed_curve[1]);

			by_before[l] += turns * (R(1) - share);
			by_acting[l] += turns * share * slope * factor[l];
		}
	}
}

/* What rotor speed times body rate turns with: sum over rotors, rows (9) by moment and rate. */
static void rotors_motion(const struct plan *p, const real *restrict after, real *restrict matrix)
{
	rows_clear(matrix, 9);
	for (size_t m = 0; m < p->motors; ++m)
		for (size_t j = 0; j < 9; ++j)
			FOR_LANES(l)
				matrix[j * LANES + l] = real_fma(after[m * LANES + l], p->propulsion.motion[9u * m + j],
								 matrix[j * LANES + l]);
}

/* Moment over the factor of inertia [N m], rows (3): an aircraft with twice the inertia turns as one with half the moment.
 * Thrust, drag torque, reaction to the rotors' acceleration, gyroscopic moment, rotor drag and rolling moment. */
void rotors_moment(const struct plan *p, const struct block *b, const struct turning *t, const real *rate,
		   real *restrict moment)
{
	const struct propulsion *const own = &p->propulsion;
	real roll[LANES] = {0}, pitch[LANES] = {0}, yaw[LANES] = {0}, gained[LANES] = {0};
	real thrust[LANES], ratio[LANES], matrix[9 * LANES];

	for (size_t m = 0; m < p->motors; ++m) {
		const real *const after = t->after + m * LANES, *const turned = t->gained + m * LANES;

		rotor_loads(own, after, thrust, ratio);
		FOR_LANES(l) {
			roll[l] = real_fma(own->lever[2u * m], thrust[l], roll[l]);
			pitch[l] = real_fma(own->lever[2u * m + 1u], thrust[l], pitch[l]);
			yaw[l] = real_fma(own->drag[m] * ratio[l], thrust[l], yaw[l]);
			gained[l] = real_fma(own->reaction[m], turned[l], gained[l]);
		}
	}
	rotors_motion(p, t->after, matrix);
	for (size_t j = 0; j < 3; ++j)
		FOR_LANES(l) {
			const real *const of = matrix + 3u * j * LANES + l;
			real turned = of[0] * rate[l];

			turned = real_fma(of[LANES], rate[LANES + l], turned);
			moment[j * LANES + l] = real_fma(of[2 * LANES], rate[2 * LANES + l], turned) * b->light[l];
		}
	FOR_LANES(l) {
		moment[l] = real_fma(b->lift[l], roll[l], moment[l]);
		moment[LANES + l] = real_fma(b->lift[l], pitch[l], moment[LANES + l]);
		moment[2 * LANES + l] =
			real_fma(b->drag[l], yaw[l], real_fma(b->light[l], gained[l], moment[2 * LANES + l]));
	}
}

/* Adds to by->before, by->after and by_rate what goes through the moment. */
void rotors_moment_back(const struct plan *p, const struct block *b, const struct turning *t, const real *rate,
			const real *by_moment, struct by_turning *by, real *by_rate)
{
	const struct propulsion *const own = &p->propulsion;
	const real *const by_roll = by_moment, *const by_pitch = by_moment + LANES, *const by_yaw = by_pitch + LANES;
	real thrust[LANES], ratio[LANES], thrust_slope[LANES], ratio_slope[LANES], matrix[9 * LANES];

	for (size_t m = 0; m < p->motors; ++m) {
		const real *const after = t->after + m * LANES, *const motion = own->motion + 9u * m;
		real *const by_before = by->before + m * LANES, *const by_after = by->after + m * LANES;

		rotor_loads(own, after, thrust, ratio);
		polynomial_slope_row(&own->thrust, after, thrust_slope);
		polynomial_slope_row(&own->torque, after, ratio_slope);
		FOR_LANES(l) {
			const real w = after[l];
			const real coefficient = w > R(0) ? thrust[l] / w : R(0);
			const real slope = real_fma(thrust_slope[l] * w, w, R(2) * coefficient);
			const real by_torque = b->drag[l] * own->drag[m] * by_yaw[l];
			const real by_thrust = b->lift[l] * (own->lever[2u * m] * by_roll[l] +
							     own->lever[2u * m + 1u] * by_pitch[l]) +
					       by_torque * ratio[l];
			const real by_gain = b->light[l] * own->reaction[m] * by_yaw[l];
			real by_motion = R(0);

			for (size_t j = 0; j < 3; ++j)
				by_motion += by_moment[j * LANES + l] *
					     (motion[3u * j] * rate[l] + motion[3u * j + 1u] * rate[LANES + l] +
					      motion[3u * j + 2u] * rate[2 * LANES + l]);
			by_after[l] += by_thrust * slope + by_torque * ratio_slope[l] * thrust[l] + by_gain +
				       b->light[l] * by_motion;
			by_before[l] -= by_gain;
		}
	}
	rotors_motion(p, t->after, matrix);
	for (size_t c = 0; c < 3; ++c)
		FOR_LANES(l)
			by_rate[c * LANES + l] += b->light[l] * (matrix[c * LANES + l] * by_roll[l] +
								 matrix[(3u + c) * LANES + l] * by_pitch[l] +
								 matrix[(6u + c) * LANES + l] * by_yaw[l]);
}

/* A rotor's speed in the word of its ESC, as sim/physics/esc.py: the period in whole microseconds, of which nine bits fit. */
static inline real speed_told(real turn, real speed)
{
	const real period = most(real_floor(turn / speed), R(1));
	real step = R(1);

	for (real full = R(1u << ESC_BITS); full < R(ESC_PERIOD_MAX); full += full)
		step = period >= full ? step + step : step;
	return period <= R(ESC_PERIOD_MAX) ? turn / (real_floor(period / step) * step) : R(0);
}

/* Speeds that ESCs tell of these, rows (M). */
void rotors_told(const struct plan *p, const real *speed, real *restrict told)
{
	if (!p->controller.words) {
		rows_copy(told, speed, p->motors);
		return;
	}
	for (size_t i = 0; i < p->motors * LANES; ++i)
		told[i] = speed_told(p->controller.rotor_turn, speed[i]);
}
