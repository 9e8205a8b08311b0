/* The host as a board: the simulator's packets are its sensors and motors, lockstep is its clock. */
#define _GNU_SOURCE
#include "hal/hal.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>

#include "hal/host/board.h"
#include "hal/host/convert.h"
#include "hal/host/link.h"
#include "hal/host/msp_tcp.h"
#include "hal/host/options.h"
#include "hal/host/receiver_line.h"

static struct host {
	struct options options;
	struct link link;
	struct msp_tcp tcp;
	struct receiver_line line;
	enum board_alignment alignment;
	struct imu_sample sample;    /* the last one */
	unsigned long held;          /* samples repeated because a rate was NaN */
	uint16_t dshot[NF_MOTOR_COUNT_MAX];
	size_t motor_count;
	sigset_t while_waiting;      /* signals let through only there */
} host;

static volatile sig_atomic_t ended;

static void end(int signal_number)
{
	(void)signal_number;
	ended = 1;
}

/* SIGTERM and SIGINT end the program between two packets: they are let in only where it waits. */
static void hold_signals(void)
{
	const struct sigaction action = { .sa_handler = end };
	sigset_t held;

	sigemptyset(&held);
	sigaddset(&held, SIGTERM);
	sigaddset(&held, SIGINT);
	sigprocmask(SIG_BLOCK, &held, &host.while_waiting);
	sigdelset(&host.while_waiting, SIGTERM);
	sigdelset(&host.while_waiting, SIGINT);
	sigaction(SIGTERM, &action, NULL);
	sigaction(SIGINT, &action, NULL);
}

int hal_init(int argc, char **argv, struct hal_info *info)
{
	const int start = options_parse(&host.options, argc, argv);
	if (start != HAL_RUN)
		return start;

	hold_signals();
	if (host.options.with_parent)
		prctl(PR_SET_PDEATHSIG, SIGTERM);
	if (!link_open(&host.link, &host.options))
		return 1;
	if (!msp_tcp_open(&host.tcp, host.options.msp_port)) {
		link_close(&host.link);
		return 1;
	}
	*info = (struct hal_info){
		.alignment = HOST_GYRO_ALIGNMENT,
		.gyro_rate_hz = host.options.gyro_hz,
		.identity = host_identity,
		.cycles_hz = 1000000000u,
	};
	host.alignment = info->alignment;
	return HAL_RUN;
}

/* One state packet: one sample, one reply. A rate that is NaN is stopped here: no chip could say it, so the
 * chip says what it said before. */
static void step(const struct hal_handlers *handlers)
{
	double rates_frd[3];
	uint16_t channels_us[NF_CHANNEL_COUNT];

	if (!link_take_state(&host.link, rates_frd))
		return;
	while (link_take_receiver(&host.link, channels_us))
		receiver_line_put(&host.line, channels_us);
	link_drain_power(&host.link);
	if (!convert_rates(rates_frd, host.alignment, host.sample.gyro))
		host.held++;
	host.sample.valid = true;
	handlers->sample(handlers->context, &host.sample);
	handlers->background(handlers->context);
	link_send_motors(&host.link, host.dshot, host.motor_count);
}

static void say_ready(void)
{
	printf("ready state=%u receiver=%u power=%u msp=%u\n", link_port(host.link.state),
	       link_port(host.link.receiver), link_port(host.link.power), link_port(host.tcp.listener));
	fflush(stdout);
}

static void say_what_was_wrong(void)
{
	if (host.link.ignored > 0)
		fprintf(stderr, "neuroflight: ignored %lu packets of a wrong size\n", host.link.ignored);
	if (host.held > 0)
		fprintf(stderr, "neuroflight: %lu gyro samples were NaN, the one before was repeated\n", host.held);
}

int hal_run(const struct hal_handlers *handlers, const struct nf_settings *settings)
{
	(void)settings;
	int code = 0;

	say_ready();
	while (!ended) {
		struct pollfd wait[] = {
			{ .fd = host.link.state, .events = POLLIN },
			{ .fd = host.tcp.listener, .events = POLLIN },
			{ .fd = host.tcp.client, .events = POLLIN },
		};
		if (ppoll(wait, sizeof wait / sizeof wait[0], NULL, &host.while_waiting) < 0) {
			if (errno == EINTR)
				continue;
			fprintf(stderr, "neuroflight: cannot wait for packets: %s\n", strerror(errno));
			code = 1;
			break;
		}
		if (wait[0].revents)
			step(handlers);
		if (wait[1].revents || wait[2].revents)
			msp_tcp_serve(&host.tcp, handlers);
	}
	msp_tcp_close(&host.tcp);
	link_close(&host.link);
	say_what_was_wrong();
	return code;
}

int hal_refuse(enum nf_err why)
{
	switch (why) {
	case NF_ERR_GYRO_RATE:
		fprintf(stderr,
			"neuroflight: --gyro-hz got %u, expected 1000, 2000, 4000 or 8000 and a multiple of the "
			"policy's control rate, %u Hz\n",
			host.options.gyro_hz, (unsigned)POLICY_CONTROL_RATE_HZ);
		break;
	case NF_ERR_OBSERVATION:
		fprintf(stderr, "neuroflight: the policy asks for an observation that this firmware does not have; "
				"build both from one source\n");
		break;
	default:
		fprintf(stderr, "neuroflight: the board's configuration is refused (error %d)\n", (int)why);
		break;
	}
	msp_tcp_close(&host.tcp);
	link_close(&host.link);
	return 1;
}

size_t hal_receiver_read(uint8_t *bytes, size_t capacity)
{
	return receiver_line_take(&host.line, bytes, capacity);
}

void hal_motors_write(const uint16_t dshot[], size_t count, bool telemetry)
{
	(void)telemetry;
	host.motor_count = count < NF_MOTOR_COUNT_MAX ? count : NF_MOTOR_COUNT_MAX;
	memcpy(host.dshot, dshot, host.motor_count * sizeof dshot[0]);
}

void hal_trace_write(const struct control_trace *trace)
{
	link_send_trace(&host.link, trace);
}

uint32_t hal_cycles(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (uint32_t)now.tv_sec * 1000000000u + (uint32_t)now.tv_nsec;
}

bool hal_deadline_missed(uint32_t cycles)
{
	(void)cycles;
	return false;
}

void hal_power_read(struct power_sample *power)
{
	*power = (struct power_sample){ 0 };
}

void hal_beeper(bool on)
{
	(void)on;
}

void hal_led(bool on)
{
	(void)on;
}

void hal_watchdog_feed(void)
{
}

const uint8_t *hal_flash_at(uint32_t address)
{
	return (const uint8_t *)0 + 0 * address;
}

bool hal_flash_erase(unsigned sector)
{
	(void)sector;
	return false;
}

bool hal_flash_program(uint32_t address, const void *words, size_t bytes)
{
	(void)address;
	(void)words;
	(void)bytes;
	return false;
}

bool hal_fault_take(struct fault_record *record)
{
	(void)record;
	return false;
}

void hal_fault_clear(void)
{
}

void hal_reset(void)
{
}
