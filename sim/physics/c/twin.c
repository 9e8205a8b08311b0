/* One sample of N aircraft: command -> delay -> rotor speed -> wind, wash -> wrench -> supply -> bodies -> sensors. */
#include <string.h>

#include "air.h"
#include "rotor.h"

static void twin_turn_rotors(struct twin *t)
{
	const size_t motors = t->rotors->motors, all = t->count * motors;

	memcpy(t->before, t->rotor_speed, all * sizeof(double));
	for (size_t i = 0; i < all; ++i) {
		const size_t craft = i / motors;
		const double target = rotor_target_speed(t->propulsion, t->acting[i]) *
				      t->supply->voltage_ratio[craft] * t->speed_factor[i];

		t->rotor_speed[i] =
			rotor_next_speed(t->propulsion, t->response + 3u * craft, t->before[i], target);
		if (t->phase != NULL)
			t->phase[i] += 0.5 * t->dt * (t->before[i] + t->rotor_speed[i]);
	}
}

/* Velocity through moving air, body axes; advances the gusts. */
static void twin_meet_wind(struct twin *t)
{
	for (size_t i = 0; i < t->count; ++i) {
		double through[3];

		for (size_t j = 0; j < 3; ++j)
			through[j] = t->world->velocity[3u * i + j] - t->wind->velocity[3u * i + j];
		t->airspeed[i] = sqrt(through[0] * through[0] + through[1] * through[1] + through[2] * through[2]);
		turned_back(t->world->rotation + 9u * i, through, t->air_velocity + 3u * i);
	}
	wind_step(t->wind, t->count, t->airspeed);
}

static void twin_find_wrenches(struct twin *t)
{
	const double *const velocity = t->wind != NULL ? t->air_velocity : t->world->body_velocity;

	if (t->thrust_factor != NULL)
		rotor_advance(t->propulsion, t->rotors, t->count, t->rotor_speed, velocity, t->world->rate,
			      t->thrust_factor, t->torque_factor);
	if (t->wash != NULL) {
		wash_shake(t->wash, t->propulsion, t->count, t->rotors->motors, t->rotor_speed, velocity,
			   t->load_factor, t->thrust_factor);
		wash_step(t->wash, t->count, t->rotors->motors);
	}
	rotor_wrenches(t->propulsion, t->rotors, t->count, t->dt, t->before, t->rotor_speed, velocity, t->world->rate,
		       t->thrust_factor, t->torque_factor, t->load_factor, t->wrench);
	for (size_t i = 0; t->world->mount == MOUNT_FREE && i < t->count; ++i) {
		double drag[3];

		air_body_drag(t->air_density, velocity + 3u * i, t->drag_area, drag);
		for (size_t j = 0; j < 3; ++j)
			t->wrench[6u * i + j] += drag[j];
	}
}

/* Advances the bodies, and finds the specific force from the change of velocity. */
static bool twin_move(struct twin *t)
{
	struct world *const w = t->world;

	memcpy(t->earlier, w->velocity, 3u * t->count * sizeof(double));
	if (!world_step(w, t->wrench))
		return false;
	for (size_t i = 0; i < t->count; ++i) {
		double *const force = t->specific_force + 3u * i;
		double gained[3];

		if (w->mount == MOUNT_CENTRE) {
			for (size_t j = 0; j < 3; ++j)
				force[j] = t->wrench[6u * i + j] / t->mass[i];
			continue;
		}
		for (size_t j = 0; j < 3; ++j)
			gained[j] = (w->velocity[3u * i + j] - t->earlier[3u * i + j]) * t->rate_hz;
		gained[2] += t->field;
		turned_back(w->rotation + 9u * i, gained, force);
	}
	return true;
}

/* What an ideal sensor reads. */
static void twin_copy(size_t count, const int64_t *which, const double *value, double *reading)
{
	for (size_t k = 0; k < count; ++k) {
		const size_t i = which != NULL ? (size_t)which[k] : k;

		memcpy(reading + 3u * i, value + 3u * i, 3u * sizeof(double));
	}
}

/* Where the centre is held no specific force exists: an accelerometer reads gravity alone, upwards. */
static void twin_feel_support(struct twin *t, size_t count, const int64_t *which)
{
	for (size_t k = 0; k < count; ++k) {
		const size_t i = which != NULL ? (size_t)which[k] : k;

		for (size_t j = 0; j < 3; ++j)
			t->acceleration[3u * i + j] = t->world->rotation[9u * i + 6u + j] * t->gravity;
	}
}

/* New sensor readings of the aircraft of `which` (count); NULL: of the first `count`. */
void twin_measure(struct twin *t, size_t count, const int64_t *which)
{
	const uint32_t motors = t->rotors->motors;

	if (t->gyroscope != NULL)
		sensor_read(t->gyroscope, count, which, t->world->rate, motors, t->phase, t->rotor_speed, t->gyro);
	else
		twin_copy(count, which, t->world->rate, t->gyro);
	if (t->world->mount == MOUNT_CENTRE)
		twin_feel_support(t, count, which);
	else if (t->accelerometer != NULL)
		sensor_read(t->accelerometer, count, which, t->specific_force, motors, t->phase, t->rotor_speed,
			    t->acceleration);
	else
		twin_copy(count, which, t->specific_force, t->acceleration);
}

/* Advances by one sample with the commands given. A bad command changes nothing. */
int twin_step(struct twin *t)
{
	if (!delay_step(t->delay, t->count, t->command, t->acting))
		return STEP_BAD_COMMAND;
	twin_turn_rotors(t);
	if (t->wind != NULL)
		twin_meet_wind(t);
	twin_find_wrenches(t);
	supply_step(t->supply, t->propulsion, t->count, t->before, t->rotor_speed); /* the next sample meets its voltage */
	if (!twin_move(t))
		return STEP_BULLET_FAILED;
	twin_measure(t, t->count, NULL);
	return STEP_DONE;
}

/* Advances by samples of the same commands; gyros (samples, N, 3) get what each reads after them. */
int twin_run(struct twin *t, size_t samples, double *gyros)
{
	for (size_t sample = 0; sample < samples; ++sample) {
		const int failed = twin_step(t);

		if (failed != STEP_DONE)
			return failed;
		memcpy(gyros + 3u * t->count * sample, t->gyro, 3u * t->count * sizeof(double));
	}
	return STEP_DONE;
}
