#include <dlfcn.h>

#include "api.h"
#include "bullet.h"

#define PLUGIN_VERSION 202010061 /* of Bullet's shared memory, SHARED_MEMORY_MAGIC_NUMBER */

typedef struct bullet_handle *handle;

/* The beginning of struct b3PluginContext. */
struct plugin_context {
	handle client;
};

static struct {
	handle (*submit)(handle client, handle command);
	handle (*force_command)(handle client);
	void (*add_torque)(handle command, int body, int link, const double *torque, int frame);
	void (*add_force)(handle command, int body, int link, const double *force, const double *at, int frame);
	handle (*step_command)(handle client);
	handle (*state_command)(handle client, int body);
	int (*state)(handle status, int *body, int *positions, int *speeds, const double **inertial_frame,
		     const double **position, const double **speed, const double **reaction);
} bullet;

static handle given; /* the client that this library was last loaded into */

/* ---- called by Bullet, when Python loads this library as a plugin ---- */

int initPlugin(struct plugin_context *context);
void exitPlugin(struct plugin_context *context);
int executePluginCommand(struct plugin_context *context, const void *arguments);

int initPlugin(struct plugin_context *context)
{
	given = context->client;
	return PLUGIN_VERSION;
}

void exitPlugin(struct plugin_context *context)
{
	(void)context;
}

int executePluginCommand(struct plugin_context *context, const void *arguments)
{
	(void)context;
	(void)arguments;
	return -1;
}

/* ---- called by Python ---- */

/* Finds Bullet's functions in the library of the loaded package. Returns NULL, or the name of what is missing. */
const char *bullet_open(const char *pybullet)
{
	static const char *const names[] = {"b3SubmitClientCommandAndWaitStatus",
					    "b3ApplyExternalForceCommandInit",
					    "b3ApplyExternalTorque",
					    "b3ApplyExternalForce",
					    "b3InitStepSimulationCommand",
					    "b3RequestActualStateCommandInit",
					    "b3GetStatusActualState"};
	void **const functions[] = {(void **)&bullet.submit,       (void **)&bullet.force_command,
				    (void **)&bullet.add_torque,   (void **)&bullet.add_force,
				    (void **)&bullet.step_command, (void **)&bullet.state_command,
				    (void **)&bullet.state};
	void *const library = dlopen(pybullet, RTLD_NOW | RTLD_NOLOAD);

	if (library == NULL)
		return pybullet;
	for (size_t i = 0; i < sizeof names / sizeof *names; ++i) {
		*functions[i] = dlsym(library, names[i]);
		if (*functions[i] == NULL)
			return names[i];
	}
	return NULL;
}

/* The client that this library was loaded into since the last call; NULL: none. */
void *bullet_client(void)
{
	const handle client = given;

	given = NULL;
	return client;
}

/* ---- called by world.c ---- */

/* torque (N, 3) and force (N, 3), at the link's centre of mass, on each body until the next step. force may be NULL.
 * Each goes in a command of its own: of several in one, Bullet 3.25 mixes up the numbers. */
void bullet_push(void *client, size_t count, const int32_t *bodies, int link, int frame, const double *torque,
		 const double *force)
{
	static const double centre[3];

	for (size_t i = 0; i < count; ++i) {
		const handle command = bullet.force_command(client);

		bullet.add_torque(command, bodies[i], link, torque + 3u * i, frame);
		bullet.submit(client, command);
	}
	for (size_t i = 0; force != NULL && i < count; ++i) {
		const handle command = bullet.force_command(client);

		bullet.add_force(command, bodies[i], link, force + 3u * i, centre, frame);
		bullet.submit(client, command);
	}
}

/* False: Bullet refuses. */
bool bullet_step(void *client)
{
	return bullet.submit(client, bullet.step_command(client)) != NULL;
}

/* What `state` points to holds until the next command. False: Bullet refuses. */
bool bullet_read(void *client, int32_t body, struct bullet_state *state)
{
	const handle status = bullet.submit(client, bullet.state_command(client, body));

	return status != NULL &&
	       bullet.state(status, NULL, NULL, NULL, NULL, &state->place, &state->motion, NULL) != 0;
}
