#define _GNU_SOURCE
#include "hal/host/options.h"

#include <errno.h>
#include <getopt.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include "hal/host/changes.h"
#include "port/hal.h"

#define PORT_MAX 65535u
#define MOTOR_MS_MAX 10000u

static const struct number {
	const char *name;
	size_t offset;
	unsigned preset;
	unsigned max;
	const char *help;
} numbers[] = {
	{ "state-port", offsetof(struct options, state_port), NF_SIM_STATE_PORT, PORT_MAX,
	  "UDP, in: one state packet is one gyro sample" },
	{ "receiver-port", offsetof(struct options, receiver_port), NF_SIM_RECEIVER_PORT, PORT_MAX,
	  "UDP, in: receiver channels, before the state packet they belong to" },
	{ "power-port", offsetof(struct options, power_port), NF_SIM_POWER_PORT, PORT_MAX,
	  "UDP, in: battery; without a packet it is full" },
	{ "motor-port", offsetof(struct options, motor_port), NF_SIM_MOTOR_PORT, PORT_MAX,
	  "UDP, out: the one reply to each state packet, up to four motors" },
	{ "servo-port", offsetof(struct options, servo_port), NF_SIM_SERVO_PORT, PORT_MAX,
	  "UDP, out: that reply for more than four motors" },
	{ "trace-port", offsetof(struct options, trace_port), 0, PORT_MAX,
	  "UDP, out: trace of each control step, before its reply; 0 is off" },
	{ "msp-port", offsetof(struct options, msp_port), NF_MSP_TCP_PORT, PORT_MAX, "TCP: MSP, two clients at once" },
	{ "motor-ms", offsetof(struct options, motor_ms), 0, MOTOR_MS_MAX,
	  "ms without a state packet until motors are sent again; 0 is never" },
	{ "gyro-hz", offsetof(struct options, gyro_hz), 0, NF_GYRO_EDGE_RATE_HZ,
	  "gyro samples per second; 0 is as set" },
};
#define NUMBER_COUNT (sizeof numbers / sizeof numbers[0])
enum { SETTINGS = NUMBER_COUNT, BLACKBOX, SET, REPLAY, WITH_PARENT, HELP, OPTION_COUNT };

static void options_print_help(void)
{
	printf("usage: neuroflight [options]\n"
	       "The firmware as a program, flown by a simulator in lockstep. Loopback only.\n\n");
	for (size_t i = 0; i < NUMBER_COUNT; ++i)
		printf("  --%-14s N  %s (%u)\n", numbers[i].name, numbers[i].help, numbers[i].preset);
	printf("  --%-14s F  %s\n", "settings",
	       "file with the flash: settings, policies, faults; made if there is none, with this build's policy");
	printf("  --%-14s F  %s\n", "blackbox", "file that logs of flights are appended to; made if there is none");
	printf("  --%-14s S  %s\n", "set", "NAME=VALUE: a setting of this start; may be repeated");
	printf("  --%-14s F  %s\n", "replay",
	       "a flight's inputs, - for stdin; what comes of them goes to stdout, and it ends");
	printf("  --%-14s    %s\n", "with-parent", "end when the parent process ends");
	printf("  --%-14s    %s\n", "help", "print this and end");
	printf("\nPort 0 takes any free port; the line \"ready\" on stdout tells which.\n");
}

static bool options_parse_number(const char *text, unsigned max, unsigned *value)
{
	char *end;

	errno = 0;
	const unsigned long parsed = strtoul(text, &end, 10);
	if (errno || end == text || *end || text[0] == '-' || parsed > max)
		return false;
	*value = (unsigned)parsed;
	return true;
}

static bool options_take_number(struct options *options, size_t index, const char *text)
{
	if (options_parse_number(text, numbers[index].max, (unsigned *)((char *)options + numbers[index].offset)))
		return true;
	fprintf(stderr, "neuroflight: --%s got '%s', expected a whole number from 0 to %u\n", numbers[index].name, text,
		numbers[index].max);
	return false;
}

static bool options_take_change(struct options *options, const char *text)
{
	struct setting_change change;

	if (!change_parse(text, &change)) {
		fprintf(stderr, "neuroflight: --set got '%s', expected NAME=VALUE of a setting within its limits\n",
			text);
		return false;
	}
	if (options->change_count == NF_SETTING_COUNT) {
		fprintf(stderr, "neuroflight: --set was given more than %d times\n", NF_SETTING_COUNT);
		return false;
	}
	options->changes[options->change_count++] = change;
	return true;
}

/* Applies option number `index`. Returns HAL_RUN or an exit code. */
static int options_take_next(struct options *options, size_t index, const char *text)
{
	switch (index) {
	case SETTINGS:
		options->settings = text;
		return HAL_RUN;
	case BLACKBOX:
		options->blackbox = text;
		return HAL_RUN;
	case SET:
		return options_take_change(options, text) ? HAL_RUN : 1;
	case REPLAY:
		options->replay = text;
		return HAL_RUN;
	case WITH_PARENT:
		options->with_parent = true;
		return HAL_RUN;
	case HELP:
		options_print_help();
		return 0;
	default:
		return options_take_number(options, index, text) ? HAL_RUN : 1;
	}
}

int options_parse(struct options *options, int argc, char **argv)
{
	struct option known[OPTION_COUNT + 1] = {
		[SETTINGS] = { .name = "settings", .has_arg = required_argument },
		[BLACKBOX] = { .name = "blackbox", .has_arg = required_argument },
		[SET] = { .name = "set", .has_arg = required_argument },
		[REPLAY] = { .name = "replay", .has_arg = required_argument },
		[WITH_PARENT] = { .name = "with-parent" },
		[HELP] = { .name = "help" },
	};
	int index, code = HAL_RUN;

	*options = (struct options){ 0 };
	for (size_t i = 0; i < NUMBER_COUNT; ++i) {
		*(unsigned *)((char *)options + numbers[i].offset) = numbers[i].preset;
		known[i] = (struct option){ .name = numbers[i].name, .has_arg = required_argument };
	}

	/* An abbreviation that getopt accepts may become ambiguous later: names must be complete. */
	while (code == HAL_RUN && optind < argc) {
		const char *word = argv[optind];
		if (getopt_long(argc, argv, "", known, &index) != 0) {
			/* getopt has printed its message, unless the argument is no option. */
			if (optind < argc && argv[optind] == word)
				fprintf(stderr, "neuroflight: '%s' is no option, see --help\n", word);
			return 1;
		}
		code = options_take_next(options, (size_t)index, optarg);
	}
	return code;
}
