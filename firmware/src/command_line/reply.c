#include "command_line/reply.h"

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
	printer_text(t->out, "; a diff of Betaflight's: neuroflight board settings import");
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
