/* The host as a board: the simulator's packets are its sensors and motors, lockstep is its clock. */
#define _GNU_SOURCE
#include "port/hal.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>

#include "hal/host/board.h"
#include "hal/host/convert.h"
#include "hal/host/flash_file.h"
#include "hal/host/link.h"
#include "hal/host/log_file.h"
#include "hal/host/msp_tcp.h"
#include "hal/host/options.h"
#include "hal/host/replay_stream.h"
#include "policy.h"
#include "runtime.h"

static struct host {
	struct options options;
	struct link link;
	struct msp_tcp tcp;
	struct flash_file flash;
	struct host_board board;
	struct log_file log;
	struct hal hal;              /* of the board */
	double time_s;               /* of the last state packet; NaN: there was none */
	bool deaf;                   /* the user was told that receiver packets are ignored */
	unsigned long bad;           /* samples whose rate was NaN */
	sigset_t while_waiting;      /* signals let through only there */
	uint64_t answered_ns;        /* when motors were sent last; 0: never */
	bool spins;                  /* the packet before it came within SPIN_NS of an answer */
	bool restarts;               /* MSP or the command line ended it, not a signal */
} host;

/* A simulator that sends its next packet so soon after the answer is awaited without sleeping: a wake-up takes as long as
 * a sample does. A simulator that keeps to real time never does. */
#define SPIN_NS 50000
#define LINK_SOCKETS 3 /* to the simulator: state, receiver, power */
#define LOOK_NS 500000 /* between two looks at signals and MSP while packets are awaited so */

/* The longest silence that is counted: a longer one has the same effect. */
#define SILENCE_MAX_S 10.0

/* Wait between a restart's last reply and closing the connections. When a WebSocket closes, the Betaflight app discards
 * replies that it has not decoded yet, among them the one that makes it reconnect. 20 ms were enough (measured). */
#define LAST_REPLY_NS 50000000

static volatile sig_atomic_t ended;

static void host_end(int signal_number)
{
	ended = 1;
}

/* SIGTERM and SIGINT end the program between two packets: they are unblocked only while it waits. */
static void host_hold_signals(void)
{
	const struct sigaction action = { .sa_handler = host_end };
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

static void host_trace_write(void *context, const struct control_trace *trace)
{
	link_send_trace(&host.link, trace);
}

static uint64_t host_now_ns(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

/* The program's own time: what other programs of the computer take is no load of the aircraft. */
static uint32_t host_cycles(void *context)
{
	struct timespec used;

	clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
	return (uint32_t)((uint64_t)used.tv_sec * 1000000000u + (uint64_t)used.tv_nsec);
}

static bool host_reset(void *context, enum nf_reboot kind)
{
	if (kind != NF_REBOOT_FIRMWARE)
		return false;
	host.restarts = true;
	ended = 1;
	return true;
}

/* Opens what a simulator and MSP's peers speak to. */
static bool host_open(const struct options *options)
{
	if (!link_open(&host.link, options))
		return false;
	if (msp_tcp_open(&host.tcp, options->msp_port))
		return true;
	link_close(&host.link);
	return false;
}

int hal_init(int argc, char **argv, struct hal_info *info)
{
	const int start = options_parse(&host.options, argc, argv);
	if (start != HAL_RUN)
		return start;

	host_hold_signals();
	if (host.options.with_parent)
		prctl(PR_SET_PDEATHSIG, SIGTERM);
	if (!flash_file_open(&host.flash, host.options.settings, host_board_install))
		return 1;
	host_board_init(&host.board, host.flash.bytes);
	if (host.options.blackbox) {
		if (!log_file_open(&host.log, host.options.blackbox))
			return 1;
		host.board.log = &host.log.device;
	}
	host.hal = host_board_hal(&host.board);
	host.hal.flash = flash_file_interface(&host.flash, &host.hal.flash);
	host.hal.trace_write = host_trace_write;
	host.hal.cycles = host_cycles;
	host.hal.reset = host_reset;
	if (host.options.replay == NULL && !host_open(&host.options))
		return 1;
	host.time_s = (double)NAN;
	*info = (struct hal_info){
		.bank = HOST_BANK,
		.hal = &host.hal,
		.alignment = HOST_GYRO_ALIGNMENT,
		.gyro_rate_hz = host.options.gyro_hz,
		.changes = host.options.changes,
		.change_count = host.options.change_count,
		.identity = host_identity,
		.cycles_hz = 1000000000u,
	};
	return HAL_RUN;
}

/* A jump in the time of the simulator's packets counts as silence of the gyro. */
static void host_pass_silence(const struct hal_handlers *handlers, double time_s)
{
	double silence = time_s - host.time_s;

	host.time_s = time_s;
	if (!(silence > 0.001 * NF_GYRO_BAD_MS))
		return;
	if (silence > SILENCE_MAX_S)
		silence = SILENCE_MAX_S;
	for (; silence >= 0.001 * NF_GYRO_BAD_MS; silence -= 0.001 * NF_GYRO_BAD_MS)
		handlers->gyro_silent(handlers->context);
}

/* Warns, once, that receiver packets are ignored because receiver_protocol is msp. */
static void host_say_deaf(void)
{
	if (!host.deaf)
		fprintf(stderr, "neuroflight: receiver packets are ignored: receiver_protocol is msp, expected sbus or "
				"crsf; with msp channels come by SET_RAW_RC\n");
	host.deaf = true;
}

/* Takes the receiver, power and rotor packets that have arrived. */
static void host_take_receiver_and_power(void)
{
	uint16_t channels_us[NF_CHANNEL_COUNT];
	union beside_packet packet;

	while (link_take_receiver(&host.link, channels_us))
		if (!receiver_line_put(&host.board.line, channels_us))
			host_say_deaf();
	while (link_take_beside(&host.link, &packet)) {
		if (packet.magic == NF_SIM_ROTOR_MAGIC) {
			memcpy(host.board.rotors, packet.rotors.words, sizeof host.board.rotors);
			continue;
		}
		host.board.power = convert_power((double)packet.power.volts, (double)packet.power.amps);
		host.board.control_us = (double)packet.power.control_us;
	}
}

/* One state packet: one sample, one reply. Returns whether there was one. */
static bool host_step(const struct hal_handlers *handlers)
{
	struct state_packet state;

	if (!link_take_state(&host.link, &state))
		return false;
	host_take_receiver_and_power();
	host_pass_silence(handlers, state.time_s);
	const struct imu_sample sample = host_board_sample(state.rates_frd, state.force_frd);
	host.bad += !sample.valid;
	handlers->sample(handlers->context, &sample);
	handlers->background(handlers->context);
	link_send_motors(&host.link, host.board.dshot, host.board.motor_count);
	msp_tcp_speak(&host.tcp, handlers);
	host.answered_ns = host_now_ns();
	return true;
}

/* Sends the motors again once options.motor_ms have passed without a state packet: a simulator that waits for motors
 * before it sends its state, or that lost a packet, would otherwise wait for us while we wait for it. Returns the time
 * until they are due next. */
static struct timespec host_call(void)
{
	const uint64_t period_ns = host.options.motor_ms * 1000000ull, now_ns = host_now_ns();

	if (now_ns - host.answered_ns >= period_ns) {
		link_send_motors(&host.link, host.board.dshot, POLICY_ACTION_COUNT);
		host.answered_ns = now_ns;
	}
	const uint64_t left_ns = host.answered_ns + period_ns - now_ns;
	return (struct timespec){ (time_t)(left_ns / 1000000000u), (long)(left_ns % 1000000000u) };
}

/* Answers state packets for LOOK_NS at most, as long as each comes within SPIN_NS of the answer before. Meanwhile the
 * processor is lent to whoever needs it. */
static void host_spin(const struct hal_handlers *handlers)
{
	const uint64_t began_ns = host_now_ns();

	for (uint64_t now_ns = began_ns; host.spins && now_ns - began_ns < LOOK_NS; now_ns = host_now_ns()) {
		if (host_step(handlers))
			continue;
		host.spins = now_ns - host.answered_ns < SPIN_NS;
		sched_yield();
	}
}

/* Returns whether whoever started the program can read it. */
static bool host_print_ready(void)
{
	printf("ready state=%u receiver=%u power=%u msp=%u\n", link_port(host.link.state),
	       link_port(host.link.receiver), link_port(host.link.power), link_port(host.tcp.listener));
	if (fflush(stdout) == 0)
		return true;
	fprintf(stderr, "neuroflight: cannot write to stdout: %s; give it a place for the line \"ready\"\n",
		strerror(errno));
	return false;
}

static void host_print_problems(void)
{
	if (host.link.ignored > 0)
		fprintf(stderr, "neuroflight: ignored %lu packets of a wrong size\n", host.link.ignored);
	if (host.link.late > 0)
		fprintf(stderr, "neuroflight: dropped %lu receiver packets that came behind a newer one\n",
			host.link.late);
	if (host.bad > 0)
		fprintf(stderr, "neuroflight: %lu gyro samples were NaN\n", host.bad);
}

int hal_run(const struct hal_handlers *handlers, const struct nf_settings *settings)
{
	receiver_line_start(&host.board.line, settings->receiver_protocol);
	if (host.options.replay)
		return replay_stream_run(((const struct runtime *)handlers->context)->firmware, host.options.replay);
	int code = host_print_ready() ? 0 : 1;

	while (!ended && code == 0) {
		struct timespec limit = { 0 };
		struct pollfd wait[LINK_SOCKETS + MSP_TCP_SOCKETS] = {
			{ .fd = host.link.state, .events = POLLIN },
			{ .fd = host.link.receiver, .events = POLLIN },
			{ .fd = host.link.power, .events = POLLIN },
		};
		bool called = false;

		host_spin(handlers);
		msp_tcp_await(&host.tcp, wait + LINK_SOCKETS);
		if (!host.spins && host.options.motor_ms > 0)
			limit = host_call();
		const bool limited = host.spins || host.options.motor_ms > 0;
		if (ppoll(wait, sizeof wait / sizeof wait[0], limited ? &limit : NULL, &host.while_waiting) < 0) {
			if (errno == EINTR)
				continue;
			fprintf(stderr, "neuroflight: cannot wait for packets: %s\n", strerror(errno));
			code = 1;
			break;
		}
		if (wait[0].revents) {
			host.spins = host_now_ns() - host.answered_ns < SPIN_NS;
			host_step(handlers);
		}
		/* Read before the socket is full: it would then drop new packets, and only the newest counts. */
		if (wait[1].revents || wait[2].revents)
			host_take_receiver_and_power();
		for (unsigned i = 0; i < MSP_TCP_SOCKETS; ++i)
			called |= wait[LINK_SOCKETS + i].revents != 0;
		if (called)
			msp_tcp_serve(&host.tcp, handlers);
	}
	if (host.restarts)
		nanosleep(&(const struct timespec){ .tv_nsec = LAST_REPLY_NS }, NULL);
	msp_tcp_close(&host.tcp);
	link_close(&host.link);
	host_print_problems();
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
	case NF_ERR_SETTINGS:
		fprintf(stderr, "neuroflight: the settings of --set contradict each other or those of --settings; "
				"look up their limits\n");
		break;
	case NF_ERR_OBSERVATION:
		fprintf(stderr, "neuroflight: the policy asks for an observation that this firmware does not have; "
				"build both from one source\n");
		break;
	default:
		fprintf(stderr, "neuroflight: the board's configuration is refused (error %d)\n", (int)why);
		break;
	}
	if (host.options.replay)
		return 1;
	msp_tcp_close(&host.tcp);
	link_close(&host.link);
	return 1;
}

/* A program's faults are its operating system's. */
bool hal_fault_take(struct fault_record *record)
{
	return false;
}

void hal_fault_clear(void)
{
}
