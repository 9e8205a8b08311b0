/* msp_tcp.c with handlers that write down what they were called for: "reset 0", "heard 1 abc". Each hears and says one
 * byte back. */
#include <netinet/in.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>

#include "hal/host/msp_tcp.h"

static struct msp_tcp tcp;
static char notes[4096];
static size_t unasked; /* bytes that port 0 still says unasked */

static void note(const char *what, unsigned port, const void *bytes, size_t count)
{
	const size_t at = strlen(notes);

	snprintf(notes + at, sizeof notes - at, "%s %u%s%.*s\n", what, port, count ? " " : "", (int)count,
		 (const char *)bytes);
}

static size_t peers_link(void *context, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply,
			 size_t capacity)
{
	const size_t said = port == 0 && unasked < capacity ? unasked : port == 0 ? capacity : 0;

	(void)context;
	if (count > 0) {
		note("heard", port, bytes, count);
		reply[0] = bytes[0];
		return 1;
	}
	memset(reply, 'u', said);
	unasked -= said;
	return said;
}

static void peers_reset(void *context, unsigned port)
{
	(void)context;
	note("reset", port, NULL, 0);
}

static bool peers_busy(void *context, unsigned port)
{
	(void)context;
	(void)port;
	return false;
}

static const struct hal_handlers handlers = {
	.link = peers_link,
	.link_reset = peers_reset,
	.link_busy = peers_busy,
};

/* Returns the port that is listened on, 0: none. */
unsigned peers_open(void)
{
	struct sockaddr_in address = { 0 };
	socklen_t size = sizeof address;

	unasked = 0;
	if (!msp_tcp_open(&tcp, 0))
		return 0;
	getsockname(tcp.listener, (struct sockaddr *)&address, &size);
	return ntohs(address.sin_port);
}

/* One turn of the program's loop. Returns how many sockets were ready within `wait_ms`. */
int peers_turn(int wait_ms)
{
	struct pollfd wait[MSP_TCP_SOCKETS];
	msp_tcp_await(&tcp, wait);
	const int ready = poll(wait, MSP_TCP_SOCKETS, wait_ms);

	if (ready > 0)
		msp_tcp_serve(&tcp, &handlers);
	return ready;
}

void peers_say(size_t bytes)
{
	unasked = bytes;
	msp_tcp_speak(&tcp, &handlers);
}

/* What was noted since the last call. */
const char *peers_notes(void)
{
	static char taken[sizeof notes];

	memcpy(taken, notes, sizeof notes);
	notes[0] = 0;
	return taken;
}

void peers_close(void)
{
	msp_tcp_close(&tcp);
}
