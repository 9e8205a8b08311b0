/* What Python calls of the simulator link (ports/simulator_link.py, ports/host.py, ports/betaflight/fleet.py). Python reads this file as it stands:
 * plain declarations only; it skips the lines that begin with #. */
#ifndef PORTS_API_H
#define PORTS_API_H

#include <stdbool.h>
#include <stdint.h>

enum {
	LINK_VALUES = 21, /* of a Sample: gyro, specific force, rotation by rows, velocity, position */
	LINK_STATE_VALUES = 18, /* of a state packet, contract/simulator_link.py */
	LINK_CHANNELS = 16,
	LINK_TURN_MS = 100, /* the longest wait without a look at signals */
	LINK_PACKET_MAX = 256, /* longer than any good packet, so that a longer one shows */
	SERVO_MOTORS = 16, /* that a servo packet has room for */
};

/* How an exchange went. */
enum {
	LINK_SAME, /* no control step, and the motor packet has the bytes of the one before */
	LINK_NEW, /* a motor packet, at a control step a trace packet too */
	LINK_AGAIN, /* nothing came yet: await again, after what signals ask for */
	LINK_SILENT, /* nothing came in time; `awaits` says what */
	LINK_FAILED, /* a call of the system failed; `error` is its errno */
};

enum { LINK_MOTORS, LINK_TRACE, LINK_NOTHING };

struct link_packet {
	int size;
	uint8_t bytes[LINK_PACKET_MAX];
};

/* Both ends of the wire to one host program. */
struct link {
	int state, receiver, motors, trace; /* sockets, the first two connected */
	int timeout_ms; /* of each answer */
	int64_t spin_ns; /* to look for an answer before the thread sleeps; 0: sleep at once */
	struct link_packet motor_packet, trace_packet;
	struct link_packet before; /* the motor packet before */
	int64_t sent_ns; /* when the sample was sent */
	int awaits; /* LINK_MOTORS, LINK_TRACE or LINK_NOTHING */
	bool traced; /* this sample is a control step */
	bool spins; /* the last answer came within spin_ns */
	int error;
};

/* The simulator's ends of the sockets to `count` Betaflights and what they are told of their aircraft, a row for each. */
struct fleet {
	int count;
	int motors; /* of each, at most SERVO_MOTORS */
	const int *sockets;
	uint64_t limit_ns; /* up to which they run next, of their time */
	double time_s; /* of the sample */
	const double *rates; /* (count, 3) [rad/s], in the axes of the wire */
	const double *force; /* (count, 3) [m/s^2], body axes */
	const double *rotation, *velocity, *position; /* (count, 9), (count, 3), (count, 3), as of a Sample */
	const uint16_t *channels; /* (count, LINK_CHANNELS) [us] */
	const bool *heard; /* (count,): whether a receiver packet comes with the sample */
	float *widths; /* (count, motors) [us] that they answer; as before where one does not */
	int next; /* that is awaited, or failed */
	int error;
};

/* Values of a state packet. values: of a Sample; rates [rad/s] and force [m/s^2]: in the axes of the wire; pressure: of
 * the air [Pa]. */
void link_state(double time_s, const double rates[], const double force[], const double values[], double pressure,
		double packet[]);

/* Values of the host program's state packet at a Sample's `values`. */
void link_host_state(double time_s, const double values[], double packet[]);

/* Sends a sample, before it a receiver packet of channels [us] unless they are NULL, and awaits the motor packet, at a
 * control step a trace packet too. */
int link_exchange(struct link *link, double time_s, const double values[], const uint16_t channels[],
		  bool control_step);

/* Goes on awaiting. */
int link_await(struct link *link);

/* Sends all Betaflights their sample and has them run: LINK_NEW, or LINK_FAILED. */
int fleet_send(struct fleet *fleet);

/* Awaits that all stand again: LINK_NEW; LINK_AGAIN to be called again; LINK_SILENT or LINK_FAILED of `next`. */
int fleet_await(struct fleet *fleet);

#endif
