#define _GNU_SOURCE
#include "hal/host/link.h"

#include <arpa/inet.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "hal/host/convert.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "packets are read and written as they lie");

#define MOTOR_PACKET_MOTORS 4
#define SERVO_PACKET_MOTORS 16
#define PACKET_MAX 256 /* longer than any good packet, so that a longer one shows */
#define LATE_MAX_S 1.0 /* own choice: no packet takes this long over loopback */
#define LATE_IN_A_ROW 10 /* after so many the sender's clock has gone back; 0.1 s at 100 packets/s */

/* The packets of toolchain/contract/simulator_link.py. */
struct receiver_packet {
	double time_s;
	uint16_t channels_us[NF_CHANNEL_COUNT];
};
struct servo_packet {
	uint16_t count, pad;
	float widths_us[SERVO_PACKET_MOTORS];
};
struct trace_packet {
	uint32_t magic, step;
	float setpoint[3], gyro[3], throttle;
	uint8_t motor_count, flags, pad[2];
	uint16_t dshot[NF_MOTOR_COUNT_MAX];
};
_Static_assert(sizeof(struct state_packet) == NF_SIM_STATE_BYTES, "state");
_Static_assert(sizeof(struct receiver_packet) == NF_SIM_RECEIVER_BYTES, "receiver");
_Static_assert(sizeof(struct power_packet) == NF_SIM_POWER_BYTES, "power");
_Static_assert(sizeof(struct rotor_packet) == NF_SIM_ROTOR_BYTES, "rotors");
_Static_assert(sizeof(float[MOTOR_PACKET_MOTORS]) == NF_SIM_MOTOR_BYTES, "motor");
_Static_assert(sizeof(struct servo_packet) == NF_SIM_SERVO_BYTES, "servo");
_Static_assert(sizeof(struct trace_packet) == NF_SIM_TRACE_BYTES, "trace");

static int link_bind(const char *name, unsigned port)
{
	const struct sockaddr_in address = link_loopback(port);
	const int bound = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);

	if (bound >= 0 && bind(bound, (const struct sockaddr *)&address, sizeof address) == 0)
		return bound;
	fprintf(stderr,
		"neuroflight: %s port %u on 127.0.0.1: %s; stop what holds it or choose another with --%s-port\n", name,
		port, strerror(errno), name);
	if (bound >= 0)
		close(bound);
	return -1;
}

bool link_open(struct link *link, const struct options *options)
{
	*link = (struct link){
		.state = -1,
		.receiver = -1,
		.power = -1,
		.heard_s = (double)NAN,
		.motor_port = options->motor_port,
		.servo_port = options->servo_port,
		.trace_port = options->trace_port,
	};
	if ((link->state = link_bind("state", options->state_port)) >= 0 &&
	    (link->receiver = link_bind("receiver", options->receiver_port)) >= 0 &&
	    (link->power = link_bind("power", options->power_port)) >= 0)
		return true;
	link_close(link);
	return false;
}

void link_close(struct link *link)
{
	const int sockets[] = { link->state, link->receiver, link->power };

	for (size_t i = 0; i < sizeof sockets / sizeof sockets[0]; ++i)
		if (sockets[i] >= 0)
			close(sockets[i]);
}

unsigned link_port(int bound)
{
	struct sockaddr_in address = { 0 };
	socklen_t size = sizeof address;

	getsockname(bound, (struct sockaddr *)&address, &size);
	return ntohs(address.sin_port);
}

/* Takes one waiting packet. Returns its size, 0 if none waits. An empty packet counts as one byte: no packet has either
 * size. */
static size_t link_take(int bound, uint8_t packet[PACKET_MAX])
{
	const ssize_t size = recv(bound, packet, PACKET_MAX, MSG_DONTWAIT);

	return size < 0 ? 0 : size == 0 ? 1 : (size_t)size;
}

/* Counts a packet of a wrong size. The first is reported at once, as its sender may be waiting for an answer. */
static void link_ignore(struct link *link, const char *name, size_t size, size_t expected)
{
	if (link->ignored++ == 0)
		fprintf(stderr, "neuroflight: a %s packet of %zu bytes, expected %zu: ignored, as all such will be\n",
			name, size, expected);
}

bool link_take_state(struct link *link, struct state_packet *state)
{
	uint8_t bytes[PACKET_MAX];
	const size_t size = link_take(link->state, bytes);

	if (size == sizeof *state)
		memcpy(state, bytes, sizeof *state);
	else if (size > 0)
		link_ignore(link, "state", size, sizeof *state);
	return size == sizeof *state;
}

bool link_take_receiver(struct link *link, uint16_t channels_us[NF_CHANNEL_COUNT])
{
	uint8_t bytes[PACKET_MAX];
	struct receiver_packet packet;

	for (size_t size; (size = link_take(link->receiver, bytes)) > 0;) {
		if (size != sizeof packet) {
			link_ignore(link, "receiver", size, sizeof packet);
			continue;
		}
		memcpy(&packet, bytes, sizeof packet);
		if (packet.time_s < link->heard_s && packet.time_s > link->heard_s - LATE_MAX_S &&
		    link->late_in_a_row < LATE_IN_A_ROW) {
			++link->late;
			++link->late_in_a_row;
			continue;
		}
		link->late_in_a_row = 0;
		link->heard_s = packet.time_s;
		memcpy(channels_us, packet.channels_us, sizeof packet.channels_us);
		return true;
	}
	return false;
}

bool link_take_beside(struct link *link, union beside_packet *packet)
{
	uint8_t bytes[PACKET_MAX] = { 0 };

	for (size_t size; (size = link_take(link->power, bytes)) > 0;) {
		memcpy(packet, bytes, sizeof *packet);
		if ((size == sizeof packet->power && packet->magic == NF_SIM_POWER_MAGIC) ||
		    (size == sizeof packet->rotors && packet->magic == NF_SIM_ROTOR_MAGIC))
			return true;
		link_ignore(link, "power", size, sizeof packet->power);
	}
	return false;
}

/* A simulator that has ended is no error: the packet is lost. */
static void link_send(const struct link *link, unsigned port, const void *packet, size_t size)
{
	const struct sockaddr_in address = link_loopback(port);

	(void)!sendto(link->state, packet, size, 0, (const struct sockaddr *)&address, sizeof address);
}

void link_send_motors(const struct link *link, const uint16_t dshot[], size_t count)
{
	if (count <= MOTOR_PACKET_MOTORS) {
		float fractions[MOTOR_PACKET_MOTORS] = { 0 };
		for (size_t i = 0; i < count; ++i)
			fractions[i] = convert_dshot(dshot[i]);
		link_send(link, link->motor_port, fractions, sizeof fractions);
		return;
	}
	struct servo_packet packet = { .count = (uint16_t)count };
	for (size_t i = 0; i < count; ++i)
		packet.widths_us[i] = 1000.0f + 1000.0f * convert_dshot(dshot[i]);
	link_send(link, link->servo_port, &packet, sizeof packet);
}

void link_send_trace(const struct link *link, const struct control_trace *trace)
{
	struct trace_packet packet = {
		.magic = NF_SIM_TRACE_MAGIC,
		.step = trace->step,
		.throttle = trace->throttle,
		.motor_count = trace->motor_count,
		.flags = trace->armed ? NF_SIM_TRACE_FLAG_ARMED : 0,
	};

	if (link->trace_port == 0)
		return;
	memcpy(packet.setpoint, trace->setpoint, sizeof packet.setpoint);
	memcpy(packet.gyro, trace->gyro, sizeof packet.gyro);
	memcpy(packet.dshot, trace->dshot, sizeof packet.dshot);
	link_send(link, link->trace_port, &packet, sizeof packet);
}
