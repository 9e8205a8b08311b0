/* The simulator's wire: UDP packets on loopback, Betaflight's format, little-endian. */
#pragma once

#include <netinet/in.h>

#include "common/status.h"
#include "hal/host/options.h"
#include "nf_contract.h"

struct link {
	int state, receiver, power;     /* sockets */
	unsigned motor_port, servo_port, trace_port;
	unsigned long ignored;          /* packets of a wrong size */
	double heard_s;                 /* time stamp of the last receiver packet taken; NaN: none yet */
	unsigned long late;             /* receiver packets dropped because a newer one came first */
	unsigned late_in_a_row;         /* of those, without a good one between them */
};

/* Binds the three ports. On failure one line on stderr and false. */
bool link_open(struct link *link, const struct options *options);

void link_close(struct link *link);

/* The address of that port of this computer. */
static inline struct sockaddr_in link_loopback(unsigned port)
{
	return (struct sockaddr_in){
		.sin_family = AF_INET,
		.sin_port = htons((uint16_t)port),
		.sin_addr.s_addr = htonl(INADDR_LOOPBACK),
	};
}

/* The port that a socket is bound to. */
unsigned link_port(int bound);

/* A state packet; axes forward, right, down. */
struct state_packet {
	double time_s;
	double rates_frd[3]; /* rad/s */
	double force_frd[3]; /* specific force, m/s^2 */
	double ignored[11];
};

/* A power packet. */
struct __attribute__((packed)) power_packet {
	uint32_t magic;
	double time_s;
	float volts, amps;
	float control_us; /* that each control step takes; 0: not told */
};

/* A rotor packet. */
struct __attribute__((packed)) rotor_packet {
	uint32_t magic;
	double time_s;
	uint16_t words[NF_MOTOR_COUNT_MAX];
};

/* A power or a rotor packet: its magic says which. */
union beside_packet {
	uint32_t magic;
	struct power_packet power;
	struct rotor_packet rotors;
};

/* Takes one waiting state packet. False if none was waiting or it was malformed. */
bool link_take_state(struct link *link, struct state_packet *state);

/* Takes one waiting receiver packet; returns false if no good one waits. A packet whose time stamp is older than the
 * last one's was overtaken on its way and is dropped, as it would undo the pilot's newer input. If it is more than 1 s
 * older, or follows 10 dropped ones, the sender's clock was reset, and it is taken. */
bool link_take_receiver(struct link *link, uint16_t channels_us[NF_CHANNEL_COUNT]);

/* Takes one waiting packet of the power port. False if no good one waits. */
bool link_take_beside(struct link *link, union beside_packet *packet);

/* The one reply to a state packet: on the motor port, or for more than four motors on the servo port. */
void link_send_motors(const struct link *link, const uint16_t dshot[], size_t count);

/* The control step, if somebody asked for traces. */
void link_send_trace(const struct link *link, const struct control_trace *trace);
