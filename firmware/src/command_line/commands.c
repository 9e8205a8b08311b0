#include "command_line/command.h"

static bool command_help(const struct task_line *t);

static const struct command commands[] = {
	{ "help", "[COMMAND]", "lists the commands, or explains one", command_help },
	{ "version", "", "firmware, board, policy", command_version },
	{ "status", "", "state, what forbids arming, battery, policy, load", command_status },
	{ "tasks", "", "what each task takes of the processor", command_tasks },
	{ "get", "[PART OF A NAME]", "values and limits of the settings with that in their name", command_get },
	{ "set", "NAME = VALUE", "changes a setting, until the next boot unless it is saved; alone: as get",
	  command_set },
	{ "diff", "[all]", "what is not at its default; all: as text to paste, which restores all settings",
	  command_diff },
	{ "dump", "", "all settings, as text to paste", command_dump },
	{ "save", "[force]", "stores the settings, restarts; refused after an error, unless force is said",
	  command_save },
	{ "defaults", "", "all settings to their defaults, not saved yet; forgets errors", command_defaults },
	{ "motor", "[test on|test off|N VALUE SECONDS]",
	  "turns motor N at 1000 to 1500 for 1 to 5 s; any byte stops it", command_motor },
	{ "faults", "[ack]", "faults that forbid arming; ack: the pilot knows of them", command_faults },
	{ "mixer", "[list]", "there is none to choose: the policy gives each motor its fraction", command_mixer },
	{ "exit", "", "drops what is not saved, restarts", command_exit },
};
#define COMMAND_COUNT (sizeof commands / sizeof commands[0])

const struct command *command_find(const char *line, const char **arguments)
{
	line = command_skip_spaces(line);
	for (size_t i = 0; i < COMMAND_COUNT; ++i) {
		const size_t length = command_word(line, commands[i].name);
		if (length > 0) {
			*arguments = command_skip_spaces(line + length);
			return &commands[i];
		}
	}
	return NULL;
}

/* --- help ------------------------------------------------------------------------------------------------------- */
static void command_explain(const struct task_line *t, const struct command *command)
{
	const char *const gap = command->arguments[0] != '\0' ? " " : "";

	printer_line(t->out, "%s%s%s - %s", command->name, gap, command->arguments, command->help);
}

static bool command_help(const struct task_line *t)
{
	const char *rest;

	if (t->arguments[0] == '\0') {
		command_explain(t, &commands[t->row]);
		return t->row + 1 < COMMAND_COUNT;
	}
	const struct command *const command = command_find(t->arguments, &rest);
	if (command) {
		command_explain(t, command);
	} else {
		command_got(t, "help", t->arguments);
		printer_line(t->out, "a command that 'help' lists");
	}
	return false;
}
