#include "command_line/command.h"

#define GOT_MAX 32 /* characters that are repeated of what was got */
#define SHA256_SHOWN 4 /* bytes of the policy's hash that tell it apart */

/* --- Words ------------------------------------------------------------------------------------------------------ */
size_t command_word(const char *line, const char *word)
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

const char *command_skip_spaces(const char *text)
{
	while (*text == ' ')
		++text;
	return text;
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
	printer_say(t->out, COMMAND_ERROR);
}

void command_got(const struct task_line *t, const char *name, const char *got)
{
	command_error(t);
	printer_say(t->out, "%s: got '%.*s', expected ", name, GOT_MAX, got);
}

/* --- What several commands say ---------------------------------------------------------------------------------- */
void command_say_policy(const struct task_line *t)
{
	struct nf_policy_blob_header header;

	if (!policy_slots_header(t->services->slots, &header)) {
		printer_say(t->out, "none");
		return;
	}
	printer_say(t->out, "%.*s ", (int)sizeof header.aircraft, header.aircraft);
	printer_bytes(t->out, header.policy_sha256, SHA256_SHOWN);
}
