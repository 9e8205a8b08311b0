#define _GNU_SOURCE
#include "hal/host/msp_tcp.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#define REQUEST_BYTES 256
#define REPLY_BYTES 8192 /* more than the replies to a buffer full of the shortest requests */

bool msp_tcp_open(struct msp_tcp *tcp, unsigned port)
{
	const int on = 1;
	const struct sockaddr_in address = {
		.sin_family = AF_INET,
		.sin_port = htons((uint16_t)port),
		.sin_addr.s_addr = htonl(INADDR_LOOPBACK),
	};

	*tcp = (struct msp_tcp){ .client = -1 };
	tcp->listener = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
	if (tcp->listener >= 0) {
		/* Connections of an earlier run may still be closing; a port with an active listener is still
		 * refused. */
		setsockopt(tcp->listener, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
		if (bind(tcp->listener, (const struct sockaddr *)&address, sizeof address) == 0 &&
		    listen(tcp->listener, 4) == 0)
			return true;
	}
	fprintf(stderr,
		"neuroflight: MSP port %u on 127.0.0.1: %s; stop what holds it or choose another with --msp-port\n",
		port, strerror(errno));
	msp_tcp_close(tcp);
	return false;
}

static void msp_tcp_hang_up(struct msp_tcp *tcp)
{
	close(tcp->client);
	tcp->client = -1;
}

void msp_tcp_close(struct msp_tcp *tcp)
{
	if (tcp->client >= 0)
		msp_tcp_hang_up(tcp);
	if (tcp->listener >= 0)
		close(tcp->listener);
}

/* Reads from the client and replies. Returns whether nothing more can be read: no bytes are left, or the client has
 * disconnected. */
static bool msp_tcp_answer(struct msp_tcp *tcp, const struct hal_handlers *handlers)
{
	uint8_t request[REQUEST_BYTES], reply[REPLY_BYTES];
	const ssize_t received = recv(tcp->client, request, sizeof request, MSG_DONTWAIT);

	if (received < 0 && (errno == EAGAIN || errno == EINTR))
		return true;
	if (received <= 0) {
		msp_tcp_hang_up(tcp);
		return true;
	}
	const size_t size = handlers->msp(handlers->context, request, (size_t)received, reply, sizeof reply);
	/* A client that does not read its replies would get half a frame: it is disconnected. */
	if (size > 0 && send(tcp->client, reply, size, MSG_DONTWAIT | MSG_NOSIGNAL) != (ssize_t)size)
		msp_tcp_hang_up(tcp);
	return false;
}

static void msp_tcp_accept(struct msp_tcp *tcp, const struct hal_handlers *handlers)
{
	const int on = 1;
	const int caller = accept4(tcp->listener, NULL, NULL, SOCK_CLOEXEC | SOCK_NONBLOCK);

	if (caller < 0)
		return;
	if (tcp->client >= 0) {
		close(caller);
		return;
	}
	setsockopt(caller, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
	tcp->client = caller;
	handlers->msp_reset(handlers->context);
}

void msp_tcp_serve(struct msp_tcp *tcp, const struct hal_handlers *handlers)
{
	/* The bytes of a client that has disconnected are read before the next client is accepted. */
	if (tcp->client < 0 || msp_tcp_answer(tcp, handlers))
		msp_tcp_accept(tcp, handlers);
}
