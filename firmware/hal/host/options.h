/* The host program's arguments. */
#pragma once

#include <stdbool.h>
#include <stddef.h>

#include "storage/settings.h"

struct options {
	unsigned state_port, receiver_port, power_port; /* bound here; 0: any free one */
	unsigned motor_port, servo_port;                /* sent to */
	unsigned trace_port;                            /* sent to; 0: no trace */
	unsigned msp_port;                              /* listened on; 0: any free one */
	unsigned motor_ms;                              /* [ms] without state until motors are sent again */
	unsigned gyro_hz;                               /* 0: as set */
	const char *settings;                           /* file of the flash; NULL: memory */
	const char *blackbox; /* file for logs; NULL: none is written */
	struct setting_change changes[NF_SETTING_COUNT];
	size_t change_count;
	const char *replay;                             /* a flight to replay instead of being flown; NULL: none */
	bool with_parent;                               /* end when the parent process does */
	bool help;                                      /* print them and end */
};

/* Returns HAL_RUN, or the exit code: 0 after --help, 1 after one line on stderr. */
int options_parse(struct options *options, int argc, char **argv);
