/* Commands of the command line, and the state of one that runs. */
#pragma once

#include <stdbool.h>

#include "command_line/session.h"
#include "common/printer.h"
#include "common/status.h"

#define COMMAND_ERROR "###ERROR " /* so begins every line that tells an error */
#define COMMAND_ARMED "the motors are armed or under test: disarm, or wait until they rest"
#define COMMAND_FOREIGN "; a diff of Betaflight's: neuroflight board settings import" /* ends an error about one */
#define COMMAND_VERSION NF_MSP_FIRMWARE " " NF_VERSION_TEXT

/* A command at work. */
struct task_line {
	struct command_line *cl;
	const struct services *services;
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

/* Returns the command that `line` begins with, or NULL. *arguments is set to the text after it. */
const struct command *command_find(const char *line, const char **arguments);

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

/* --- reply.c: replies that several commands share, and functions that read arguments ------------------------------- */
/* Begins a line that tells an error: `save` is refused from here on. Its own errors change nothing there: it may be
 * tried again. */
void command_error(const struct task_line *t);

/* Begins an error of command `name` about its argument `got`, cut where it is long: what was got stands there, what was
 * expected is to follow. */
void command_got(const struct task_line *t, const char *name, const char *got);

/* Name and hash of the policy. */
void command_say_policy(const struct task_line *t);

/* Characters of `word` if `line` begins with it and a space or nothing follows; else 0. */
size_t command_word(const char *line, const char *word);

/* The first character that is no space. */
const char *command_skip_spaces(const char *text);

/* Is `text` exactly the word `word`? */
bool command_is(const char *text, const char *word);

/* Reads digits alone. Returns what stands behind them and the spaces after them; NULL: there are none, or too many. */
const char *command_number(const char *text, uint32_t *value);
