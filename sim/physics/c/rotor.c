#include "rotor.h"

#define TURN 6.283185307179586 /* rad */

double polynomial_value(const struct polynomial *p, double at)
{
	double value = p->term[p->terms - 1u];

	for (uint32_t i = p->terms - 1u; i-- > 0u;)
		value = value * at + p->term[i];
	return value;
}

void polynomial_values(const struct polynomial *p, size_t count, const double *at, double *value)
{
	for (size_t i = 0; i < count; ++i)
		value[i] = polynomial_value(p, at[i]);
}

/* The speed that a command settles at. Source: Koch 2019, chapter 5: H(u), a quadratic fitted on the dynamometer. */
double rotor_target_speed(const struct propulsion *p, double command)
{
	const double *const curve = p->speed_curve;
	const double speed = (curve[0] * command + curve[1]) * command + curve[2];

	return p->limited && speed > p->speed_max ? p->speed_max : speed;
}

/* voltage_ratio: of the battery under load to the supply that the curve was measured with. Speed is taken as
 * proportional to it. */
void rotor_target_speeds(const struct propulsion *p, size_t count, const double *command, const double *voltage_ratio,
			 double *speed)
{
	for (size_t i = 0; i < count; ++i)
		speed[i] = rotor_target_speed(p, command[i]) * voltage_ratio[i];
}

/* Speed after a step towards a target that stands; never below zero.
 *
 * Rotors with limits: I dw/dt = clamp(K (H(u) - w), -down, +up), exact while the clamp is away or holds throughout;
 * response: share of the way, most gain and most loss of speed in a step. Friction F of the bearing is part of K and is what
 * the clamped torque also has to overcome: I dw/dt = clamp(K (H(u) - w) + F w, -down, +up) - F w. Source: facts of the
 * published twins and Koch 2019, chapters 3 and 5. Others are of first order, exact; response: share of the way up, share of the way down. */
double rotor_next_speed(const struct propulsion *p, const double *response, double speed, double target)
{
	const double away = target - speed;
	double change;

	if (p->limited) {
		const double lost = speed / p->speed_max * response[1];

		change = response[0] * away + lost;
		change = change < -response[2] ? -response[2] : change;
		change = change > response[1] ? response[1] : change;
		change -= lost;
	} else {
		change = (away > 0.0 ? response[0] : response[1]) * away;
	}
	const double after = speed + change;

	return after > 0.0 ? after : 0.0;
}

/* response: (count, 3). */
void rotor_next_speeds(const struct propulsion *p, size_t count, const double *response, const double *speed,
		       const double *target, double *next)
{
	for (size_t i = 0; i < count; ++i)
		next[i] = rotor_next_speed(p, response + 3u * i, speed[i], target[i]);
}

/* Rows of speed (steps + 1, count): the first is where the rotors start, each further one follows a row of target (steps,
 * count). response: (3). */
void rotor_speeds_along(const struct propulsion *p, size_t steps, size_t count, const double *response,
			const double *target, double *speed)
{
	for (size_t i = 0; i < steps * count; ++i)
		speed[count + i] = rotor_next_speed(p, response, speed[i], target[i]);
}

/* K_T w^2 [N] */
double rotor_thrust(const struct propulsion *p, double speed)
{
	return polynomial_value(&p->thrust, speed) * speed * speed;
}

/* Drag torque, K_Q times the thrust [N m] */
double rotor_torque(const struct propulsion *p, double speed, double thrust)
{
	return polynomial_value(&p->torque, speed) * thrust;
}

void rotor_loads(const struct propulsion *p, size_t count, const double *speed, double *thrust, double *torque)
{
	for (size_t i = 0; i < count; ++i) {
		thrust[i] = rotor_thrust(p, speed[i]);
		torque[i] = rotor_torque(p, speed[i], thrust[i]);
	}
}

/* J = V / (n D) of a rotor that moves along its axis at `inflow` V [m/s] and makes n revolutions a second, 0 to
 * advance_max. Below 0, where a rotor sinks into its own wake, propellers are not measured: there J is advance_least at
 * least, which is 0 unless the aircraft says otherwise. A rotor that stands has one of the limits, if it moves. */
static double rotor_advance_ratio(const struct propulsion *p, double speed, double inflow)
{
	const double tip = speed * p->diameter;

	if (inflow > 0.0)
		return TURN * inflow < p->advance_max * tip ? TURN * inflow / tip : p->advance_max;
	return TURN * inflow > p->advance_least * tip ? TURN * inflow / tip : p->advance_least;
}

static double rotor_advance_factor(const double *terms, double ratio)
{
	const double factor = 1.0 + (terms[0] + terms[1] * ratio) * ratio;

	return factor > 0.0 ? factor : 0.0;
}

/* Factors (count, M) of the thrust and the drag torque of rotors that turn at `speed` (count, M) on aircraft that move at
 * `velocity` through the air and turn at `rate` (count, 3), body axes. Source: J of Koch 2019, list of symbols, and C_T(J)
 * and C_Q(J) of the UIUC Propeller Data Site, as parabolas over their values at J = 0. */
void rotor_advance(const struct propulsion *p, const struct rotors *r, size_t count, const double *speed,
		   const double *velocity, const double *rate, double *thrust_factor, double *torque_factor)
{
	double twist[6], inflow[MOTORS_MAX];

	for (size_t i = 0; i < count; ++i) {
		for (size_t j = 0; j < 3; ++j) {
			twist[j] = velocity[3u * i + j];
			twist[3u + j] = rate[3u * i + j];
		}
		row_times(twist, r->inflow, 6, r->motors, inflow);
		for (uint32_t m = 0; m < r->motors; ++m) {
			const size_t at = i * r->motors + m;
			const double ratio = rotor_advance_ratio(p, speed[at], inflow[m]);

			thrust_factor[at] = rotor_advance_factor(p->thrust_advance, ratio);
			torque_factor[at] = rotor_advance_factor(p->torque_advance, ratio);
		}
	}
}

static void rotor_scale(uint32_t motors, const double *factor, double *value)
{
	for (uint32_t i = 0; factor != NULL && i < motors; ++i)
		value[i] *= factor[i];
}

/* Rotors are upright: thrust has no yaw moment, and drag torque has no other. */
static void rotor_square_load(const struct rotors *r, const double *speed, const double *thrust_factor,
			      const double *torque_factor, double *load)
{
	double square[MOTORS_MAX], turning[MOTORS_MAX], torque[6];

	for (uint32_t i = 0; i < r->motors; ++i)
		square[i] = turning[i] = speed[i] * speed[i];
	rotor_scale(r->motors, thrust_factor, square);
	row_times(square, r->square_wrench, r->motors, 6, load);
	if (torque_factor == NULL)
		return;
	rotor_scale(r->motors, torque_factor, turning);
	row_times(turning, r->square_wrench, r->motors, 6, torque);
	load[5] = torque[5];
}

static void rotor_load(const struct propulsion *p, const struct rotors *r, const double *speed,
		       const double *thrust_factor, const double *torque_factor, double *load)
{
	double one[MOTORS_MAX], other[MOTORS_MAX], drag[6];

	if (r->square_wrench != NULL) {
		rotor_square_load(r, speed, thrust_factor, torque_factor, load);
		return;
	}
	rotor_loads(p, r->motors, speed, one, other);
	rotor_scale(r->motors, thrust_factor, one);
	rotor_scale(r->motors, torque_factor, other);
	row_times(one, r->thrust_wrench, r->motors, 6, load);
	row_times(other, r->torque_wrench, r->motors, 6, drag);
	for (size_t j = 0; j < 6; ++j)
		load[j] += drag[j];
}

/* Of all rotors of an aircraft over a step, whose ends have the speeds `before` and `after`; velocity is that of the centre
 * of mass through the air. Thrust times thrust_factor (M) and drag torque times torque_factor (M), of rotor_advance or
 * NULL, both times load_factor (6); reaction to the rotors' acceleration, gyroscopic moment, rotor drag and rolling
 * moment. */
void rotor_wrench(const struct propulsion *p, const struct rotors *r, double dt, const double *before, const double *after,
		  const double *velocity, const double *rate, const double *thrust_factor, const double *torque_factor,
		  const double *load_factor, double *wrench)
{
	double gained[MOTORS_MAX], motion[6 * MOTORS_MAX], load[6], reaction[6], drag[6];

	rotor_load(p, r, after, thrust_factor, torque_factor, load);
	for (uint32_t i = 0; i < r->motors; ++i) {
		gained[i] = (after[i] - before[i]) / dt;
		for (size_t j = 0; j < 3; ++j) {
			motion[6u * i + j] = after[i] * velocity[j];
			motion[6u * i + 3u + j] = after[i] * rate[j];
		}
	}
	row_times(gained, r->reaction_wrench, r->motors, 6, reaction);
	row_times(motion, r->motion_wrench, 6u * r->motors, 6, drag);
	for (size_t j = 0; j < 6; ++j)
		wrench[j] = load[j] * load_factor[j] + reaction[j] + drag[j];
}

void rotor_wrenches(const struct propulsion *p, const struct rotors *r, size_t count, double dt, const double *before,
		    const double *after, const double *velocity, const double *rate, const double *thrust_factor,
		    const double *torque_factor, const double *load_factor, double *wrench)
{
	for (size_t i = 0; i < count; ++i) {
		const size_t at = i * r->motors;

		rotor_wrench(p, r, dt, before + at, after + at, velocity + 3u * i, rate + 3u * i,
			     thrust_factor != NULL ? thrust_factor + at : NULL,
			     torque_factor != NULL ? torque_factor + at : NULL, load_factor + 6u * i, wrench + 6u * i);
	}
}
