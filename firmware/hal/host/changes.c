#include "hal/host/changes.h"

#include <string.h>

#include "storage/settings_text.h"

#define NAME_BYTES 40

/* As people write it; a mode range also as the number that a program has read. */
static bool change_parse_value(const char *text, const struct setting *setting, union setting_value *value)
{
	struct setting number = *setting;

	if (settings_text_parse(setting, text, value) == SETTINGS_TEXT_GOOD)
		return true;
	number.kind = SETTING_uint32_t;
	return setting->kind == SETTING_mode && settings_text_parse(&number, text, value) == SETTINGS_TEXT_GOOD;
}

bool change_parse(const char *text, struct setting_change *change)
{
	const char *equals = strchr(text, '=');
	char name[NAME_BYTES];
	struct nf_settings scratch;
	struct setting_change parsed;

	if (!equals || (size_t)(equals - text) >= sizeof name)
		return false;
	memcpy(name, text, (size_t)(equals - text));
	name[equals - text] = '\0';
	parsed.index = settings_find(name);
	if (parsed.index == NF_SETTING_COUNT ||
	    !change_parse_value(equals + 1, settings_info(parsed.index), &parsed.value))
		return false;
	settings_default(&scratch);
	if (settings_set(&scratch, parsed.index, &parsed.value) != NF_REFUSAL_NONE)
		return false;
	*change = parsed;
	return true;
}
