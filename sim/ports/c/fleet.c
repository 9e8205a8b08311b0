/* The simulator's end of the sockets to many Betaflights, which run at the same time: see betaflight/clock.c. */
#define _GNU_SOURCE
#include <errno.h>
#include <math.h>
#include <string.h>
#include <sys/socket.h>

#include "api.h"

#define SEA_LEVEL_PA 101325.0

enum { REPORT_PARKED = 1, REPORT_MAX = 2048, SERVO_BYTES = 68 };

/* Of clock.c. */
struct fleet_report {
	uint32_t kind;
	uint32_t port;
	uint64_t value;
};

struct fleet_receiver {
	double time_s;
	uint16_t channels[LINK_CHANNELS];
};

struct fleet_permit {
	uint64_t limit_ns;
	uint32_t states;
	uint32_t receivers;
	uint32_t copies;
	uint32_t reserved;
	double state[LINK_STATE_VALUES];
	struct fleet_receiver receiver; /* not sent where it says none */
};

static int fleet_failed(struct fleet *fleet, int error)
{
	fleet->error = error;
	return LINK_FAILED;
}

int fleet_send(struct fleet *fleet)
{
	for (int i = 0; i < fleet->count; i++) {
		struct fleet_permit permit = { .limit_ns = fleet->limit_ns, .states = 1, .receivers = fleet->heard[i] };
		const double *force = fleet->force + 3 * i;
		const double felt[] = { -force[0], -force[1], -force[2] };
		double values[LINK_VALUES] = { 0 };
		size_t size = sizeof permit;

		memcpy(values + 6, fleet->rotation + 9 * i, 9 * sizeof values[0]);
		memcpy(values + 15, fleet->velocity + 3 * i, 3 * sizeof values[0]);
		memcpy(values + 18, fleet->position + 3 * i, 3 * sizeof values[0]);
		link_state(fleet->time_s, fleet->rates + 3 * i, felt, values, SEA_LEVEL_PA, permit.state);
		if (fleet->heard[i]) {
			permit.receiver.time_s = fleet->time_s;
			memcpy(permit.receiver.channels, fleet->channels + LINK_CHANNELS * i,
			       sizeof permit.receiver.channels);
		} else {
			size -= sizeof permit.receiver;
		}
		fleet->next = i;
		if (send(fleet->sockets[i], &permit, size, MSG_NOSIGNAL) != (ssize_t)size)
			return fleet_failed(fleet, errno);
	}
	fleet->next = 0;
	return LINK_NEW;
}

/* Keep what the last servo packet of a report says. */
static bool fleet_take(struct fleet *fleet, const uint8_t *packets, size_t size)
{
	if (size == 0)
		return true;
	float widths[SERVO_MOTORS];
	const uint8_t *last = packets + size - SERVO_BYTES;
	uint16_t motors;

	if (size % SERVO_BYTES != 0)
		return false;
	memcpy(&motors, last, sizeof motors);
	memcpy(widths, last + 4, sizeof widths);
	for (int motor = 0; motor < fleet->motors; motor++) {
		if (!isfinite(widths[motor]))
			return false;
	}
	memcpy(fleet->widths + fleet->motors * fleet->next, widths, (size_t)fleet->motors * sizeof *widths);
	return motors == fleet->motors;
}

int fleet_await(struct fleet *fleet)
{
	uint8_t bytes[REPORT_MAX];
	struct fleet_report report;

	while (fleet->next < fleet->count) {
		const ssize_t got = recv(fleet->sockets[fleet->next], bytes, sizeof bytes, 0);
		if (got < 0)
			return errno == EINTR ? LINK_AGAIN : errno == EAGAIN ? LINK_SILENT : fleet_failed(fleet, errno);
		if ((size_t)got < sizeof report)
			return fleet_failed(fleet, ECONNRESET);
		if (!fleet_take(fleet, bytes + sizeof report, (size_t)got - sizeof report))
			return fleet_failed(fleet, EPROTO);
		memcpy(&report, bytes, sizeof report);
		if (report.kind == REPORT_PARKED)
			fleet->next++;
	}
	return LINK_NEW;
}
