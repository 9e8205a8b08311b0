/* Commands of the command line, and the state of one that runs. */
#ifndef NF_COMMAND_H
#define NF_COMMAND_H

#include <stdbool.h>

#include "command_line/printer.h"
#include "command_line/session.h"
#include "common/status.h"

/* A command at work. */
struct task_line {
	struct command_line *cl;
	const struct command_line_services *services;
	const struct firmware_status *status;
	const char *arguments; /* behind the command's name, without spaces before and behind */
	unsigned row;          /* how often it was called before */
	struct printer *out;   /* room for a line or two: COMMAND_LINE_ROOM bytes */
};

/* A row of the table of commands. */
struct command {
	const char *name;
	const char *arguments; /* that it takes, for help */
	const char *help;
	/* Prints the next one or two lines, or nothing. Returns whether it must be called again. */
	bool (*run)(const struct task_line *t);
};

/* Commands, by file. */
bool command_version(const struct task_line *t); /* report_commands.c */
bool command_status(const struct task_line *t);
bool command_tasks(const struct task_line *t);
bool command_faults(const struct task_line *t);
bool command_mixer(const struct task_line *t); /* configurators ask for it of their own accord: no error */
bool command_get(const struct task_line *t);     /* setting_commands.c */
bool command_set(const struct task_line *t);
bool command_diff(const struct task_line *t);    /* listing_commands.c */
bool command_dump(const struct task_line *t);
bool command_save(const struct task_line *t);
bool command_defaults(const struct task_line *t);
bool command_exit(const struct task_line *t);
bool command_motor(const struct task_line *t);   /* motor_commands.c */

/* Runs the motor that a command turns for its duration. Returns NULL, or the reply text once it has stopped. */
const char *command_turn_motor(struct command_line *cl, const struct firmware_status *status);

#endif
