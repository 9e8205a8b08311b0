/* pybullet's own engine, called in C.
 *
 * Python makes clients and bodies with the package pybullet. What is done at every step goes to the same client through the
 * C functions that pybullet's library exports (Bullet's PhysicsClientC_API.h): the Python layer above them takes two
 * thirds of the time. The way to a client is Bullet's plugin interface: this library is loaded into it as a plugin, and a
 * plugin is given a handle of its client. */
#ifndef BULLET_H
#define BULLET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct bullet_state {
	const double *place;   /* (3) [m] and quaternion x, y, z, w; behind them the joints' */
	const double *motion;  /* (3) [m/s] and (3) [rad/s], world axes */
};

void bullet_push(void *client, size_t count, const int32_t *bodies, int link, int frame, const double *torque,
		 const double *force);
bool bullet_step(void *client);
bool bullet_read(void *client, int32_t body, struct bullet_state *state);

#endif
