/* A whole firmware around a simulated board, for the targets that talk to it. Each input begins in one of a few states
 * that are reached once. What must hold whatever comes over a line is checked here: at each frame to the motors and at
 * each operation of flash. */
#ifndef WORLD_H
#define WORLD_H

#include "fuzz.h"

#include "hal/host/board.h"
#include "runtime.h"

#define GYRO_HZ 1000u

/* What an input finds. */
enum beginning {
	BOOTING,   /* the first samples: nothing is calibrated */
	READY,     /* the switch arms it */
	FLYING,    /* armed, in the middle of the throttle */
	READY_MSP, /* the same two, with sticks by MSP */
	FLYING_MSP,
	BEGINNING_COUNT,
};

struct world {
	struct host_board board; /* first: the context of struct hal */
	struct hal hal;
	struct firmware firmware;
	_Alignas(8) float weights[POLICY_WEIGHT_COUNT];
	struct task_stats stats[TASK_COUNT];
	struct background background;
	struct runtime runtime;
	struct log_ring log;
	uint16_t channels_us[NF_CHANNEL_COUNT]; /* of the pilot */
	bool silent;              /* the pilot's transmitter */
	bool msp;                 /* the pilot's sticks come by MSP */
	bool resets;              /* was asked to */
	uint32_t sample;          /* since boot */
	uint32_t refreshed;       /* motor_test's count of values when they last changed, and the sample of that */
	uint32_t refreshed_at;
	double shaken;            /* rad/s about all axes */
};

/* The one world, as it is at this beginning. The same each time. */
struct world *world_begin(enum beginning beginning);

/* So many gyro samples pass, with a frame of the pilot's each 10 ms. */
void world_pass(struct world *world, unsigned samples);

/* Bytes from the peer on a port, and room for so many bytes of reply. Returns the reply's size; it is the
 * caller's to free. It is whole frames of MSP, and text only if the command line is or was open. */
size_t world_talk(struct world *world, unsigned port, const uint8_t *bytes, size_t count, size_t capacity,
		  uint8_t **reply);

/* The peer on a port has paused. */
void world_pause(struct world *world, unsigned port);

/* The peer on a port has gone, another comes. */
void world_hang_up(struct world *world, unsigned port);

/* A request of MSP v1 (jumbo if it is long) or v2 around a payload. Returns its size, `frame` has FRAME_MAX bytes. */
#define WORLD_FRAME_MAX 600u
size_t world_request(unsigned version, unsigned command, const uint8_t *payload, size_t count,
		     uint8_t frame[WORLD_FRAME_MAX]);

/* What must hold when an input is over: each port answers a request for the API version, whatever came before; the
 * settings are within their limits; what flash holds can be loaded. */
void world_end(struct world *world);

#endif
