/* The rigid bodies: Bullet turns and moves them; here wrenches are applied and the angular momentum is kept.
 *
 * Bullet steps the rate by explicit Euler and then turns the body by the new rate. So its rate is kept at the middle of a
 * step, that it turns the body by the step's mean rate: the torque asked of it is the one whose Euler step ends there. The
 * momentum is integrated from the moments, and the rate at a sample follows from momentum and attitude. */
#include <math.h>
#include <string.h>

#include "bullet.h"
#include "vector.h"

#define STRAY_RATE 1e-9 /* rad/s */

/* The rotation matrix is linear in the products of a quaternion's parts. Its last element is summed in eight lanes and then
 * in pairs: the order that the stored results of docs/results were computed in. */
static void world_turn_matrix(const struct world *w, const double *quaternion, double *rotation)
{
	double parts[16], lanes[8];

	for (size_t i = 0; i < 4; ++i)
		for (size_t j = 0; j < 4; ++j)
			parts[4 * i + j] = quaternion[i] * quaternion[j];
	row_times(parts, w->attitude, 16, 9, rotation);
	for (size_t i = 0; i < 8; ++i)
		lanes[i] = fma(parts[8 + i], w->attitude[9 * (8 + i) + 8], parts[i] * w->attitude[9 * i + 8]);
	rotation[8] = ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7]));
}

static bool world_read_one(struct world *w, size_t i, struct bullet_state *state)
{
	if (!bullet_read(w->client, w->bodies[i], state))
		return false;
	world_turn_matrix(w, state->place + (w->mount == MOUNT_RIG ? 7 : 3), w->rotation + 9u * i);
	if (w->mount == MOUNT_FREE)
		memcpy(w->position + 3u * i, state->place, 3u * sizeof(double));
	else
		turned(w->rotation + 9u * i, w->arm, w->position + 3u * i);
	return true;
}

/* Attitudes and positions of the aircraft of `which` (count). False: Bullet refuses, or the world is closed. */
bool world_read_pose(struct world *w, size_t count, const int64_t *which)
{
	struct bullet_state state;

	if (w->client == NULL)
		return false;
	for (size_t k = 0; k < count; ++k)
		if (!world_read_one(w, (size_t)which[k], &state))
			return false;
	return true;
}

/* What holds the rig turns it back to level. For turns that are small: the sine of the turn stands for it. */
static void world_hold(const struct world *w, size_t i, double *moment)
{
	const double *const rotation = w->rotation + 9u * i, *const rate = w->rate + 3u * i;
	const double turn[3] = { 0.5 * (rotation[7] - rotation[5]), 0.5 * (rotation[2] - rotation[6]),
				 0.5 * (rotation[3] - rotation[1]) };

	for (size_t j = 0; j < 3; ++j)
		moment[j] -= w->stiffness[j] * turn[j] + w->damping[j] * rate[j];
}

/* Moment about the pivot, body axes; gravity pulls at the rig's hanging centre of mass. */
static void world_moment(const struct world *w, size_t i, const double *wrench, double *moment)
{
	const double down[3] = {0.0, 0.0, w->weight};
	double force[3], weight[3], swung[3];

	memcpy(moment, wrench + 3, 3u * sizeof(double));
	if (w->mount != MOUNT_RIG)
		return;
	memcpy(force, wrench, sizeof force);
	if (w->gravity) {
		row_times(down, w->rotation + 9u * i, 3, 3, weight);
		for (size_t j = 0; j < 3; ++j)
			force[j] += weight[j] * w->mass_factor[i];
	}
	row_times(force, w->swing, 3, 3, swung);
	for (size_t j = 0; j < 3; ++j)
		moment[j] -= swung[j];
	if (w->held)
		world_hold(w, i, moment);
}

/* What is asked of Bullet for a step of aircraft i, and its rate in the middle of it. */
static void world_ask(struct world *w, size_t i, const double *wrench)
{
	const size_t map = w->each ? i : 0;
	double *const inner = w->inner_rate + 3u * i, *const torque = w->torque + 3u * i;
	double own[6], turning[9], inner_turning[9], pushed[3], gyroscopic[3], gained[3], asked[3], more[3];

	for (size_t j = 0; j < 6; ++j)
		own[j] = wrench[j] / w->burden[6u * i + j];
	world_moment(w, i, own, w->moment + 3u * i);
	squares(w->rate + 3u * i, turning);
	squares(inner, inner_turning);
	row_times(w->moment + 3u * i, w->half_push + 9u * map, 3, 3, pushed);
	row_times(turning, w->half_gyro + 27u * map, 9, 3, gyroscopic);
	for (size_t j = 0; j < 3; ++j) {
		const double middle = w->rate[3u * i + j] + pushed[j] - gyroscopic[j];

		gained[j] = middle - inner[j];
		inner[j] = middle;
	}
	row_times(gained, w->rate_to_torque, 3, 3, asked);
	row_times(inner_turning, w->gyro_torque, 9, 3, more);
	for (size_t j = 0; j < 3; ++j)
		asked[j] += more[j];
	if (w->ground) { /* where contact needs the true masses, Bullet has them */
		for (size_t j = 0; j < 3; ++j) {
			asked[j] *= w->burden[6u * i + 3u + j];
			own[j] *= w->burden[6u * i + j];
		}
	}
	if (w->mount == MOUNT_RIG)
		turned(w->rotation + 9u * i, asked, torque);
	else
		memcpy(torque, asked, sizeof asked);
	row_times(own, w->axes, 3, 3, w->push + 3u * i);
}

/* Velocities of a free aircraft; the change of rate by ground contact goes into the momentum. */
static void world_take_motion(struct world *w, size_t i, const double *motion)
{
	const double *const rotation = w->rotation + 9u * i;
	double *const inner = w->inner_rate + 3u * i;
	double rate[3], impulse[3], hit[3];

	memcpy(w->velocity + 3u * i, motion, 3u * sizeof(double));
	turned_back(rotation, motion, w->body_velocity + 3u * i);
	if (!w->ground)
		return;
	turned_back(rotation, motion + 3, rate);
	for (size_t j = 0; j < 3; ++j)
		inner[j] = rate[j] - inner[j];
	row_times(inner, w->inertia, 3, 3, impulse);
	turned(rotation, impulse, hit);
	for (size_t j = 0; j < 3; ++j)
		w->momentum[3u * i + j] += hit[j];
	memcpy(inner, rate, sizeof rate);
}

/* Bullet is told how much faster to turn, never how fast: rounding that nobody corrects grows tenfold in half a minute of hard
 * flight, and after seven minutes the body turns otherwise than its momentum says. Where Bullet's rate differs from the one in the
 * middle of the step by more than rounding makes in two minutes, Bullet's is taken. */
static void world_follow(struct world *w, size_t i, const double *motion)
{
	double *const inner = w->inner_rate + 3u * i;
	double rate[3];

	turned_back(w->rotation + 9u * i, motion + 3, rate);
	for (size_t j = 0; j < 3; ++j) {
		if (fabs(rate[j] - inner[j]) > STRAY_RATE) {
			memcpy(inner, rate, sizeof rate);
			return;
		}
	}
}

static bool world_take(struct world *w, size_t i)
{
	double *const rotation = w->rotation + 9u * i, *const momentum = w->momentum + 3u * i;
	const size_t map = w->each ? i : 0;
	double mean[9], half[3], gained[3], own[3];
	struct bullet_state state;

	memcpy(mean, rotation, sizeof mean);
	if (!world_read_one(w, i, &state))
		return false;
	/* The moment keeps its body axes while they turn: it acts along their mean over the step. */
	for (size_t j = 0; j < 9; ++j)
		mean[j] += rotation[j];
	for (size_t j = 0; j < 3; ++j)
		half[j] = w->moment[3u * i + j] * w->half_step;
	turned(mean, half, gained);
	for (size_t j = 0; j < 3; ++j)
		momentum[j] += gained[j];
	if (w->mount == MOUNT_FREE)
		world_take_motion(w, i, state.motion);
	if (w->mount != MOUNT_RIG && !w->ground)
		world_follow(w, i, state.motion);
	turned_back(rotation, momentum, own);
	row_times(own, w->inverse + 9u * map, 3, 3, w->rate + 3u * i);
	if (w->mount == MOUNT_RIG) {
		row_times(w->rate + 3u * i, w->swing, 3, 3, w->body_velocity + 3u * i);
		turned(rotation, w->body_velocity + 3u * i, w->velocity + 3u * i);
	}
	return true;
}

/* Advances one time step under the wrenches (N, 6). False: Bullet refuses, or the world is closed. */
bool world_step(struct world *w, const double *wrench)
{
	if (w->client == NULL)
		return false;
	for (size_t i = 0; i < w->count; ++i)
		world_ask(w, i, wrench + 6u * i);
	bullet_push(w->client, w->count, w->bodies, w->link, w->frame, w->torque,
		    w->mount == MOUNT_FREE ? w->push : NULL);
	if (!bullet_step(w->client))
		return false;
	for (size_t i = 0; i < w->count; ++i)
		if (!world_take(w, i))
			return false;
	return true;
}
