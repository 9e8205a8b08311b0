/* The simulator's wire: UDP packets on loopback, Betaflight's format, little-endian. */
#ifndef NF_HOST_LINK_H
#define NF_HOST_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/status.h"
#include "hal/host/options.h"
#include "nf_contract.h"

struct link {
	int state, receiver, power;     /* sockets */
	unsigned motor_port, servo_port, trace_port;
	unsigned long ignored;          /* packets of a wrong size */
	double heard_s;                 /* time in the last receiver packet that was taken; NaN: there was none */
	unsigned long late;             /* receiver packets that came behind a newer one */
	unsigned late_in_a_row;
};

/* Binds the three ports. On failure one line on stderr and false. */
bool link_open(struct link *link, const struct options *options);

void link_close(struct link *link);

/* The port that a socket is bound to. */
unsigned link_port(int bound);

/* What a state packet says; axes forward, right, down. */
struct link_state {
	double time_s;
	double rates_frd[3]; /* rad/s */
	double force_frd[3]; /* specific force, m/s^2 */
};

/* What a power packet says. */
struct link_power {
	double volts, amps;
	double control_us; /* that each control step takes; 0: not told */
};

/* Takes one waiting state packet. False if none was waiting or it was malformed. */
bool link_take_state(struct link *link, struct link_state *state);

/* Takes one waiting receiver packet. False if no good one waits. What is older than the one before has been overtaken on
 * its way and is dropped: it would undo what the pilot did. Not so when it is much older, or many in a row are: then its
 * sender's clock has begun anew or went back, and the pilot must be heard. */
bool link_take_receiver(struct link *link, uint16_t channels_us[NF_CHANNEL_COUNT]);

/* Takes one waiting power packet. False if no good one waits. */
bool link_take_power(struct link *link, struct link_power *power);

/* The one reply to a state packet: on the motor port, or for more than four motors on the servo port. */
void link_send_motors(const struct link *link, const uint16_t dshot[], size_t count);

/* The control step, if somebody asked for traces. */
void link_send_trace(const struct link *link, const struct control_trace *trace);

#endif
