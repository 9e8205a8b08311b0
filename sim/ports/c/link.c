/* The simulator's end of the wire to a host program: packets out, packets in, without a wake-up where the answer comes at
 * once. */
#define _GNU_SOURCE
#include <errno.h>
#include <poll.h>
#include <sched.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

#include "api.h"

struct receiver_packet {
	double time_s;
	uint16_t channels[LINK_CHANNELS];
};

static int64_t link_now_ns(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static bool link_send(struct link *link, int to, const void *packet, size_t size)
{
	if (send(to, packet, size, MSG_NOSIGNAL) == (ssize_t)size)
		return true;
	link->error = errno;
	return false;
}

/* LINK_NEW once a packet is there; LINK_SILENT if there is none now. */
static int link_look(struct link *link, int from, struct link_packet *packet)
{
	const ssize_t size = recv(from, packet->bytes, sizeof packet->bytes, MSG_DONTWAIT | MSG_TRUNC);

	if (size >= 0) {
		packet->size = (int)size;
		return LINK_NEW;
	}
	if (errno == EAGAIN || errno == EINTR)
		return LINK_SILENT;
	link->error = errno;
	return LINK_FAILED;
}

/* An answer that came within spin_ns tells that the next will: only then is the processor kept, and lent to others. */
static int link_receive(struct link *link, int from, struct link_packet *packet)
{
	int found = link_look(link, from, packet);

	if (found != LINK_SILENT)
		return found;
	const int64_t began = link_now_ns();
	while (link->spins && link_now_ns() - began < link->spin_ns) {
		sched_yield();
		found = link_look(link, from, packet);
		if (found != LINK_SILENT)
			return found;
	}
	struct pollfd wait = { .fd = from, .events = POLLIN };
	const int ready = poll(&wait, 1, LINK_TURN_MS);
	if (ready < 0 && errno != EINTR) {
		link->error = errno;
		return LINK_FAILED;
	}
	const int64_t now = link_now_ns();
	link->spins = now - began < link->spin_ns;
	found = link_look(link, from, packet);
	if (found != LINK_SILENT)
		return found;
	return now - link->sent_ns < (int64_t)link->timeout_ms * 1000000 ? LINK_AGAIN : LINK_SILENT;
}

int link_await(struct link *link)
{
	int found;

	if (link->awaits == LINK_MOTORS) {
		found = link_receive(link, link->motors, &link->motor_packet);
		if (found != LINK_NEW)
			return found;
		link->awaits = link->traced ? LINK_TRACE : LINK_NOTHING;
	}
	if (link->awaits == LINK_TRACE) {
		found = link_receive(link, link->trace, &link->trace_packet);
		if (found != LINK_NEW)
			return found;
		link->awaits = LINK_NOTHING;
		return LINK_NEW;
	}
	const struct link_packet *now = &link->motor_packet, *before = &link->before;
	const bool same = now->size == before->size && now->size <= LINK_PACKET_MAX &&
			  memcmp(now->bytes, before->bytes, (size_t)now->size) == 0;
	return same ? LINK_SAME : LINK_NEW;
}

int link_exchange(struct link *link, double time_s, const double values[], const uint16_t channels[], bool control_step)
{
	double state[LINK_STATE_VALUES];

	link->sent_ns = link_now_ns();
	link->before = link->motor_packet;
	link->awaits = LINK_MOTORS;
	link->traced = control_step;
	if (channels) {
		struct receiver_packet receiver = { .time_s = time_s };
		memcpy(receiver.channels, channels, sizeof receiver.channels);
		if (!link_send(link, link->receiver, &receiver, sizeof receiver))
			return LINK_FAILED;
	}
	link_host_state(time_s, values, state);
	if (!link_send(link, link->state, state, sizeof state))
		return LINK_FAILED;
	return link_await(link);
}
