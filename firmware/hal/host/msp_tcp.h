/* MSP over TCP on loopback: one client a port of the program, all at one listening socket. One more is refused. */
#pragma once

#include <poll.h>

#include "nf_contract.h"
#include "port/hal.h"

#define MSP_TCP_SOCKETS (1 + NF_MSP_PORT_COUNT)
#define MSP_TCP_REPLY_BYTES 4096

struct msp_tcp_client {
	int socket; /* -1: none */
	size_t waiting; /* bytes of `reply` that the connection has not taken yet */
	uint8_t reply[MSP_TCP_REPLY_BYTES];
};

struct msp_tcp {
	int listener;
	struct msp_tcp_client clients[NF_MSP_PORT_COUNT];
};

/* Listens. On failure one line on stderr and false. */
bool msp_tcp_open(struct msp_tcp *tcp, unsigned port);

void msp_tcp_close(struct msp_tcp *tcp);

/* Fills in the descriptors to poll before the next msp_tcp_serve. */
void msp_tcp_await(const struct msp_tcp *tcp, struct pollfd wait[MSP_TCP_SOCKETS]);

/* Called when one of them is ready: handles an event of each client, and a new one, without waiting. */
void msp_tcp_serve(struct msp_tcp *tcp, const struct hal_handlers *handlers);

/* Called after each step of the program: sends unsolicited output, as much as the connections take. */
void msp_tcp_speak(struct msp_tcp *tcp, const struct hal_handlers *handlers);
