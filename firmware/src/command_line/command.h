/* What a command is, for the files that have them. */
#ifndef NF_COMMAND_H
#define NF_COMMAND_H

#include <stdbool.h>
#include <stddef.h>

#include "command_line/printer.h"
#include "command_line/session.h"
#include "common/status.h"

#define COMMAND_ERROR "###ERROR " /* so begins every line that tells an error */

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
	/* Says the next line or two, or nothing. Returns whether it wants to be called again. */
	bool (*run)(const struct task_line *t);
};

extern const struct command command_table[];
extern const size_t command_count;

/* The command that `line` begins with; NULL: none. *arguments is what stands behind it. */
const struct command *command_find(const char *line, const char **arguments);

/* Begins a line that tells an error: `save` is refused from here on. Its own errors change nothing there: it may be
 * tried again. */
void command_error(const struct task_line *t);

/* Begins an error of command `name` about its argument `got`, cut where it is long: what was got stands there, what was
 * expected is to follow. */
void command_got(const struct task_line *t, const char *name, const char *got);

/* Ends an error line about what may come from a diff of Betaflight's: says who takes that. */
void command_end_foreign(const struct task_line *t);

/* Ends an error line about armed motors or a motor test. */
void command_say_armed(const struct task_line *t);

/* Name and hash of the policy. */
void command_say_policy(const struct task_line *t);
void command_say_version(const struct task_line *t);

/* Is `text` exactly the word `word`? */
bool command_is(const char *text, const char *word);

/* Reads digits alone. Returns what stands behind them and the spaces after them; NULL: there are none, or too many. */
const char *command_number(const char *text, uint32_t *value);

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

/* Stops the motor that a command turns and closes its motor test. */
void command_stop_motor(struct command_line *cl);
/* Keeps it turning for its time. Returns NULL, or what is to be said. */
const char *command_turn_motor(struct command_line *cl, const struct firmware_status *status);

#endif
