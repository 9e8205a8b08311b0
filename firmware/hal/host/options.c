#define _GNU_SOURCE
#include "hal/host/options.h"

#include <errno.h>
#include <getopt.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include "hal/hal.h"

#define PORT_MAX 65535u

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
	  "UDP, in: battery; accepted, not used yet" },
	{ "motor-port", offsetof(struct options, motor_port), NF_SIM_MOTOR_PORT, PORT_MAX,
	  "UDP, out: the one reply to each state packet, up to four motors" },
	{ "servo-port", offsetof(struct options, servo_port), NF_SIM_SERVO_PORT, PORT_MAX,
	  "UDP, out: that reply for more than four motors" },
	{ "trace-port", offsetof(struct options, trace_port), 0, PORT_MAX,
	  "UDP, out: trace of each control step, before its reply; 0 is off" },
	{ "msp-port", offsetof(struct options, msp_port), NF_MSP_TCP_PORT, PORT_MAX, "TCP: MSP, one client at a time" },
	{ "gyro-hz", offsetof(struct options, gyro_hz), NF_GYRO_RATE_DEFAULT_HZ, NF_GYRO_EDGE_RATE_HZ,
	  "gyro samples per second" },
};
#define NUMBER_COUNT (sizeof numbers / sizeof numbers[0])
#define WITH_PARENT NUMBER_COUNT
#define HELP (NUMBER_COUNT + 1)

static void print_help(void)
{
	printf("usage: neuroflight [options]\n"
	       "The firmware as a program, flown by a simulator in lockstep. Loopback only.\n\n");
	for (size_t i = 0; i < NUMBER_COUNT; i++)
		printf("  --%-14s N  %s (%u)\n", numbers[i].name, numbers[i].help, numbers[i].preset);
	printf("  --%-14s    %s\n", "with-parent", "end when the parent process ends");
	printf("  --%-14s    %s\n", "help", "print this and end");
	printf("\nPort 0 takes any free port; the line \"ready\" on stdout tells which.\n");
}

static bool parse_number(const char *text, unsigned max, unsigned *value)
{
	char *end;

	errno = 0;
	const unsigned long parsed = strtoul(text, &end, 10);
	if (errno || end == text || *end || text[0] == '-' || parsed > max)
		return false;
	*value = (unsigned)parsed;
	return true;
}

int options_parse(struct options *options, int argc, char **argv)
{
	struct option known[NUMBER_COUNT + 3] = { 0 };
	int index;

	*options = (struct options){ 0 };
	for (size_t i = 0; i < NUMBER_COUNT; i++) {
		*(unsigned *)((char *)options + numbers[i].offset) = numbers[i].preset;
		known[i] = (struct option){ .name = numbers[i].name, .has_arg = required_argument };
	}
	known[WITH_PARENT] = (struct option){ .name = "with-parent" };
	known[HELP] = (struct option){ .name = "help" };

	/* An abbreviation that getopt accepts today may mean something else tomorrow; scripts write names out. */
	while (optind < argc) {
		const char *word = argv[optind];
		if (getopt_long(argc, argv, "", known, &index) != 0) {
			/* getopt has printed its line, unless the word is no option at all. */
			if (optind < argc && argv[optind] == word)
				fprintf(stderr, "neuroflight: '%s' is no option, see --help\n", word);
			return 1;
		}
		if ((size_t)index == HELP) {
			print_help();
			return 0;
		}
		if ((size_t)index == WITH_PARENT) {
			options->with_parent = true;
		} else if (!parse_number(optarg, numbers[index].max,
					 (unsigned *)((char *)options + numbers[index].offset))) {
			fprintf(stderr, "neuroflight: --%s got '%s', expected a whole number from 0 to %u\n",
				numbers[index].name, optarg, numbers[index].max);
			return 1;
		}
	}
	return HAL_RUN;
}
