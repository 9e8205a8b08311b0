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

struct row {
	const char *name;
	char value; /* its letter in the help, ' ': it takes none */
	bool (*take)(struct options *options, const struct row *row, const char *text);
	size_t offset;
	unsigned preset, max; /* of a number */
	const char *help;
};

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

static bool options_take_number(struct options *options, const struct row *row, const char *text)
{
	if (options_parse_number(text, row->max, (unsigned *)((char *)options + row->offset)))
		return true;
	fprintf(stderr, "neuroflight: --%s got '%s', expected a whole number from 0 to %u\n", row->name, text,
		row->max);
	return false;
}

static bool options_take_text(struct options *options, const struct row *row, const char *text)
{
	*(const char **)((char *)options + row->offset) = text;
	return true;
}

static bool options_take_flag(struct options *options, const struct row *row, const char *text)
{
	*(bool *)((char *)options + row->offset) = true;
	return true;
}

static bool options_take_change(struct options *options, const struct row *row, const char *text)
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

#define NUMBER(name, member, preset, max, help) \
	{ name, 'N', options_take_number, offsetof(struct options, member), preset, max, help }
#define TEXT(name, member, help) { name, 'F', options_take_text, offsetof(struct options, member), 0, 0, help }
#define FLAG(name, member, help) { name, ' ', options_take_flag, offsetof(struct options, member), 0, 0, help }

static const struct row rows[] = {
	NUMBER("state-port", state_port, NF_SIM_STATE_PORT, PORT_MAX, "UDP, in: one state packet is one gyro sample"),
	NUMBER("receiver-port", receiver_port, NF_SIM_RECEIVER_PORT, PORT_MAX,
	       "UDP, in: receiver channels, before the state packet they belong to"),
	NUMBER("power-port", power_port, NF_SIM_POWER_PORT, PORT_MAX, "UDP, in: battery; without a packet it is full"),
	NUMBER("motor-port", motor_port, NF_SIM_MOTOR_PORT, PORT_MAX,
	       "UDP, out: the one reply to each state packet, up to four motors"),
	NUMBER("servo-port", servo_port, NF_SIM_SERVO_PORT, PORT_MAX, "UDP, out: that reply for more than four motors"),
	NUMBER("trace-port", trace_port, 0, PORT_MAX,
	       "UDP, out: trace of each control step, before its reply; 0 is off"),
	NUMBER("msp-port", msp_port, NF_MSP_TCP_PORT, PORT_MAX, "TCP: MSP, two clients at once"),
	NUMBER("motor-ms", motor_ms, 0, MOTOR_MS_MAX,
	       "ms without a state packet until motors are sent again; 0 is never"),
	NUMBER("gyro-hz", gyro_hz, 0, NF_GYRO_EDGE_RATE_HZ, "gyro samples per second; 0 is as set"),
	TEXT("settings", settings,
	     "file with the flash: settings, policies, faults; made if there is none, with this build's policy"),
	TEXT("blackbox", blackbox, "file that logs of flights are appended to; made if there is none"),
	{ "set", 'S', options_take_change, 0, 0, 0, "NAME=VALUE: a setting of this start; may be repeated" },
	TEXT("replay", replay, "a flight's inputs, - for stdin; what comes of them goes to stdout, and it ends"),
	FLAG("with-parent", with_parent, "end when the parent process ends"),
	FLAG("help", help, "print this and end"),
};
#define ROW_COUNT (sizeof rows / sizeof rows[0])

static void options_print_help(void)
{
	printf("usage: neuroflight [options]\n"
	       "The firmware as a program, flown by a simulator in lockstep. Loopback only.\n\n");
	for (const struct row *row = rows; row < rows + ROW_COUNT; ++row) {
		printf("  --%-14s %c  %s", row->name, row->value, row->help);
		if (row->take == options_take_number)
			printf(" (%u)", row->preset);
		printf("\n");
	}
	printf("\nPort 0 takes any free port; the line \"ready\" on stdout tells which.\n");
}

int options_parse(struct options *options, int argc, char **argv)
{
	struct option known[ROW_COUNT + 1] = { 0 };
	int index;

	*options = (struct options){ 0 };
	for (size_t i = 0; i < ROW_COUNT; ++i) {
		if (rows[i].take == options_take_number)
			*(unsigned *)((char *)options + rows[i].offset) = rows[i].preset;
		known[i] = (struct option){ .name = rows[i].name, .has_arg = rows[i].value != ' ' };
	}

	/* An abbreviation that getopt accepts may become ambiguous later: names must be complete. */
	while (optind < argc) {
		const char *word = argv[optind];
		if (getopt_long(argc, argv, "", known, &index) != 0) {
			/* getopt has printed its message, unless the argument is no option. */
			if (optind < argc && argv[optind] == word)
				fprintf(stderr, "neuroflight: '%s' is no option, see --help\n", word);
			return 1;
		}
		if (!rows[index].take(options, &rows[index], optarg))
			return 1;
		if (options->help) {
			options_print_help();
			return 0;
		}
	}
	return HAL_RUN;
}
