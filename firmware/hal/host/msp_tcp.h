/* MSP over TCP on loopback: one client at a time, a second is refused. */
#ifndef NF_HOST_MSP_TCP_H
#define NF_HOST_MSP_TCP_H

#include <stdbool.h>

#include "hal/hal.h"

struct msp_tcp {
	int listener;
	int client; /* -1: none */
};

/* Listens. On failure one line on stderr and false. */
bool msp_tcp_open(struct msp_tcp *tcp, unsigned port);

void msp_tcp_close(struct msp_tcp *tcp);

/* Called when the listener or the client is readable: handles one event without waiting. */
void msp_tcp_serve(struct msp_tcp *tcp, const struct hal_handlers *handlers);

#endif
