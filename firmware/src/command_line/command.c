#include "command_line/command.h"

#include "policy.h"

#define GOT_MAX 32 /* characters that are repeated of what was got */
#define SHA256_SHOWN 4 /* bytes of the policy's hash that tell it apart */

static bool command_help(const struct task_line *t);

const struct command command_table[] = {
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
const size_t command_count = sizeof command_table / sizeof command_table[0];

/* --- Words ------------------------------------------------------------------------------------------------------ */
/* Characters of `word` if `line` begins with it and a space or nothing follows; else 0. */
static size_t command_word(const char *line, const char *word)
{
	size_t length = 0;

	for (; word[length] != '\0'; ++length)
		if (line[length] != word[length])
			return 0;
	return line[length] == ' ' || line[length] == '\0' ? length : 0;
}

bool command_is(const char *text, const char *word)
{
	const size_t length = command_word(text, word);

	return length > 0 && text[length] == '\0';
}

static const char *command_skip_spaces(const char *text)
{
	while (*text == ' ')
		++text;
	return text;
}

const struct command *command_find(const char *line, const char **arguments)
{
	line = command_skip_spaces(line);
	for (size_t i = 0; i < command_count; ++i) {
		const size_t length = command_word(line, command_table[i].name);
		if (length > 0) {
			*arguments = command_skip_spaces(line + length);
			return &command_table[i];
		}
	}
	return NULL;
}

const char *command_number(const char *text, uint32_t *value)
{
	const char *const begin = text;

	*value = 0;
	for (; *text >= '0' && *text <= '9' && *value < 100000u; ++text)
		*value = *value * 10u + (uint32_t)(*text - '0');
	return text == begin || (*text != ' ' && *text != '\0') ? NULL : command_skip_spaces(text);
}

/* --- Errors ----------------------------------------------------------------------------------------------------- */
void command_error(const struct task_line *t)
{
	t->cl->failed = true;
	printer_text(t->out, COMMAND_ERROR);
}

void command_got(const struct task_line *t, const char *name, const char *got)
{
	command_error(t);
	printer_text(t->out, name);
	printer_text(t->out, ": got '");
	printer_part(t->out, got, GOT_MAX);
	printer_text(t->out, "', expected ");
}

void command_end_foreign(const struct task_line *t)
{
	printer_text(t->out, "; a diff of Betaflight's: neuroflight msp import");
	printer_end(t->out);
}

void command_say_armed(const struct task_line *t)
{
	printer_text(t->out, "the motors are armed or under test: disarm, or wait until they rest");
	printer_end(t->out);
}

/* --- What several commands say ---------------------------------------------------------------------------------- */
void command_say_policy(const struct task_line *t)
{
	struct nf_policy_blob_header header;

	if (!policy_slots_header(t->services->slots, &header)) {
		printer_text(t->out, "none");
		return;
	}
	printer_part(t->out, header.aircraft, sizeof header.aircraft);
	printer_char(t->out, ' ');
	for (unsigned i = 0; i < SHA256_SHOWN; ++i)
		printer_hex(t->out, header.policy_sha256[i], 2);
}

void command_say_version(const struct task_line *t)
{
	printer_text(t->out, NF_MSP_FIRMWARE " " NF_VERSION_TEXT);
}

/* --- help ------------------------------------------------------------------------------------------------------- */
static void command_explain(const struct task_line *t, const struct command *command)
{
	printer_text(t->out, command->name);
	if (command->arguments[0] != '\0')
		printer_char(t->out, ' ');
	printer_text(t->out, command->arguments);
	printer_text(t->out, " - ");
	printer_text(t->out, command->help);
	printer_end(t->out);
}

static bool command_help(const struct task_line *t)
{
	const char *rest;

	if (t->arguments[0] == '\0') {
		command_explain(t, &command_table[t->row]);
		return t->row + 1 < command_count;
	}
	const struct command *const command = command_find(t->arguments, &rest);
	if (command) {
		command_explain(t, command);
	} else {
		command_got(t, "help", t->arguments);
		printer_text(t->out, "a command that 'help' lists");
		printer_end(t->out);
	}
	return false;
}
