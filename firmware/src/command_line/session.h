/* State of a command line session. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "command_line/services.h"

#define COMMAND_LINE_BYTES 96u /* of a line, its end not counted */

enum command_line_mode { COMMAND_LINE_CLOSED, COMMAND_LINE_TYPED, COMMAND_LINE_FRAMED };

enum command_line_fault {
	COMMAND_LINE_GOOD,
	COMMAND_LINE_TOO_LONG,
	COMMAND_LINE_NO_TEXT,  /* a byte that is no character */
	COMMAND_LINE_UNENDED,  /* the frame ended before the line */
	COMMAND_LINE_LOST,
};

struct command;

/* The motor that a command runs. */
struct command_line_motor {
	bool allowed; /* `motor test on` was said */
	uint32_t allowed_since; /* gyro sample of the last motor command */
	uint8_t turning; /* number of the motor, from 1; 0: none */
	uint16_t value_us;
	uint32_t since, samples; /* it turns from that gyro sample on, for so many */
	uint32_t given; /* gyro sample at which its value was given last */
};

struct command_line {
	const struct services *services;
	uint8_t mode; /* enum command_line_mode */
	uint8_t fault; /* of the line: enum command_line_fault */
	uint8_t length; /* characters of `line` */
	bool after_cr; /* an LF would belong to the CR before it */
	bool failed; /* a command failed since the session, or its frame, began: `save` is refused */
	bool found; /* the command that runs has found something */
	bool frame_ended; /* only the output before it is outstanding */
	const struct command *running; /* has more to say; NULL: none */
	uint16_t row; /* of its output */
	uint32_t heard; /* gyro sample at which the last byte came */
	struct command_line_motor motor;
	char line[COMMAND_LINE_BYTES + 1];
};

/* Gyro samples since boot; wraps. */
uint32_t command_samples(const struct command_line *cl);

/* Stops the motor that a command turns and closes its motor test. */
void command_stop_motor(struct command_line *cl);

/* A byte came that the command line does not take: a motor stops for it as for any. */
void command_line_stop(struct command_line *cl);

/* Forgets the line that is being typed. */
void command_line_clear(struct command_line *cl);

/* Ends the session because the peer speaks MSP or has gone: its motor stops, half a line is forgotten. */
void command_line_leave(struct command_line *cl);
