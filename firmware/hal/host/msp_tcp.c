#define _GNU_SOURCE
#include "hal/host/msp_tcp.h"

#include <errno.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "hal/host/link.h"
#include "msp/msp.h"

#define SEND_BYTES 65536 /* of a connection: a stream has gaps rather than become old */
#define REQUEST_BYTES (MSP_TCP_REPLY_BYTES / MSP_FRAME_MAX * MSP_REQUEST_MIN) /* whose replies all fit */

bool msp_tcp_open(struct msp_tcp *tcp, unsigned port)
{
	const int on = 1;
	const struct sockaddr_in address = link_loopback(port);

	*tcp = (struct msp_tcp){ 0 };
	for (unsigned i = 0; i < NF_MSP_PORT_COUNT; ++i)
		tcp->clients[i].socket = -1;
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

static void msp_tcp_hang_up(struct msp_tcp_client *client)
{
	close(client->socket);
	client->socket = -1;
	client->waiting = 0;
}

void msp_tcp_close(struct msp_tcp *tcp)
{
	for (unsigned i = 0; i < NF_MSP_PORT_COUNT; ++i)
		if (tcp->clients[i].socket >= 0)
			msp_tcp_hang_up(&tcp->clients[i]);
	if (tcp->listener >= 0)
		close(tcp->listener);
}

/* A client that does not read is not read either. */
void msp_tcp_await(const struct msp_tcp *tcp, struct pollfd wait[MSP_TCP_SOCKETS])
{
	wait[0] = (struct pollfd){ .fd = tcp->listener, .events = POLLIN };
	for (unsigned i = 0; i < NF_MSP_PORT_COUNT; ++i) {
		const struct msp_tcp_client *client = &tcp->clients[i];
		wait[1 + i] = (struct pollfd){ .fd = client->socket, .events = client->waiting > 0 ? POLLOUT : POLLIN };
	}
}

static bool msp_tcp_would_wait(void)
{
	return errno == EAGAIN || errno == EINTR;
}

/* Sends what waits, as far as the connection takes it. Returns false if the client has gone. */
static bool msp_tcp_send(struct msp_tcp_client *client)
{
	if (client->waiting == 0)
		return true;
	const ssize_t sent = send(client->socket, client->reply, client->waiting, MSG_DONTWAIT | MSG_NOSIGNAL);
	if (sent < 0)
		return msp_tcp_would_wait();
	client->waiting -= (size_t)sent;
	memmove(client->reply, client->reply + sent, client->waiting);
	return true;
}

/* Reads from the client and replies. Returns false if it has gone; *idle: nothing more can be read now. */
static bool msp_tcp_answer(struct msp_tcp_client *client, unsigned port, const struct hal_handlers *handlers,
			   bool *idle)
{
	uint8_t request[REQUEST_BYTES];

	*idle = true;
	if (!msp_tcp_send(client))
		return false;
	if (client->waiting > 0 || handlers->link_busy(handlers->context, port))
		return true;
	const ssize_t received = recv(client->socket, request, sizeof request, MSG_DONTWAIT);
	if (received <= 0)
		return received < 0 && msp_tcp_would_wait();
	*idle = false;
	client->waiting = handlers->link(handlers->context, port, request, (size_t)received, client->reply,
					 sizeof client->reply);
	return msp_tcp_send(client);
}

static void msp_tcp_accept(struct msp_tcp *tcp, const struct hal_handlers *handlers)
{
	const int on = 1, send_bytes = SEND_BYTES;
	const int caller = accept4(tcp->listener, NULL, NULL, SOCK_CLOEXEC | SOCK_NONBLOCK);

	if (caller < 0)
		return;
	setsockopt(caller, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
	setsockopt(caller, SOL_SOCKET, SO_SNDBUF, &send_bytes, sizeof send_bytes);
	for (unsigned i = 0; i < NF_MSP_PORT_COUNT; ++i)
		if (tcp->clients[i].socket < 0) {
			tcp->clients[i].socket = caller;
			handlers->link_reset(handlers->context, i);
			return;
		}
	close(caller);
}

/* A client's state ends when it disconnects, not when the next one connects. */
static void msp_tcp_leave(struct msp_tcp_client *client, unsigned port, const struct hal_handlers *handlers)
{
	msp_tcp_hang_up(client);
	handlers->link_reset(handlers->context, port);
}

void msp_tcp_speak(struct msp_tcp *tcp, const struct hal_handlers *handlers)
{
	for (unsigned i = 0; i < NF_MSP_PORT_COUNT; ++i) {
		struct msp_tcp_client *client = &tcp->clients[i];
		while (client->socket >= 0 && client->waiting == 0) {
			client->waiting = handlers->link(handlers->context, i, NULL, 0, client->reply,
							 sizeof client->reply);
			if (client->waiting == 0)
				break;
			if (!msp_tcp_send(client))
				msp_tcp_leave(client, i, handlers);
		}
	}
}

void msp_tcp_serve(struct msp_tcp *tcp, const struct hal_handlers *handlers)
{
	bool free_port = false, all_idle = true;

	for (unsigned i = 0; i < NF_MSP_PORT_COUNT; ++i) {
		struct msp_tcp_client *client = &tcp->clients[i];
		bool idle = true;
		if (client->socket >= 0 && !msp_tcp_answer(client, i, handlers, &idle))
			msp_tcp_leave(client, i, handlers);
		free_port |= client->socket < 0;
		all_idle &= idle;
	}
	/* The bytes of a client that has disconnected are read before another one is turned away. */
	if (free_port || all_idle)
		msp_tcp_accept(tcp, handlers);
	msp_tcp_speak(tcp, handlers);
}
