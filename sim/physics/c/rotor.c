#include "rotor.h"

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

	return (curve[0] * command + curve[1]) * command + curve[2];
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
 * response: share of the way, most gain and most loss of speed in a step. Source: facts of the published twin and Koch
 * 2019, chapter 5. Others are of first order, exact; response: share of the way up, share of the way down. */
double rotor_next_speed(const struct propulsion *p, const double *response, double speed, double target)
{
	const double away = target - speed;
	double change;

	if (p->limited) {
		change = response[0] * away;
		change = change < -response[2] ? -response[2] : change;
		change = change > response[1] ? response[1] : change;
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

static void rotor_load(const struct propulsion *p, const struct rotors *r, const double *speed, double *load)
{
	double one[MOTORS_MAX], other[MOTORS_MAX], drag[6];

	if (r->square_wrench != NULL) {
		for (uint32_t i = 0; i < r->motors; ++i)
			one[i] = speed[i] * speed[i];
		row_times(one, r->square_wrench, r->motors, 6, load);
		return;
	}
	rotor_loads(p, r->motors, speed, one, other);
	row_times(one, r->thrust_wrench, r->motors, 6, load);
	row_times(other, r->torque_wrench, r->motors, 6, drag);
	for (size_t j = 0; j < 6; ++j)
		load[j] += drag[j];
}

/* Of all rotors of an aircraft over a step, whose ends have the speeds `before` and `after`; velocity is that of the centre
 * of mass through the air. Thrust and drag torque times load_factor (6), reaction to the rotors' acceleration, gyroscopic
 * moment, rotor drag and rolling moment. */
void rotor_wrench(const struct propulsion *p, const struct rotors *r, double dt, const double *before, const double *after,
		  const double *velocity, const double *rate, const double *load_factor, double *wrench)
{
	double gained[MOTORS_MAX], motion[6 * MOTORS_MAX], load[6], reaction[6], drag[6];

	rotor_load(p, r, after, load);
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
		    const double *after, const double *velocity, const double *rate, const double *load_factor,
		    double *wrench)
{
	for (size_t i = 0; i < count; ++i)
		rotor_wrench(p, r, dt, before + i * r->motors, after + i * r->motors, velocity + 3u * i, rate + 3u * i,
			     load_factor + 6u * i, wrench + 6u * i);
}
