#include "hal/host/changes.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#define NAME_BYTES 40

static bool change_parse_value(const char *text, enum setting_kind kind, union setting_value *value)
{
	char *end;

	memset(value, 0, sizeof *value);
	if (kind == SETTING_text) {
		const size_t length = strlen(text);
		memcpy(value->as_text, text, length < sizeof value->as_text ? length : sizeof value->as_text);
		return length <= sizeof value->as_text;
	}
	errno = 0;
	if (kind == SETTING_float) {
		value->as_float = strtof(text, &end);
	} else {
		const unsigned long whole = strtoul(text, &end, 10);
		if (text[0] == '-' || whole > UINT32_MAX)
			return false;
		value->as_uint32_t = (uint32_t)whole;
	}
	return errno == 0 && end != text && *end == '\0';
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
	    !change_parse_value(equals + 1, settings_info(parsed.index)->kind, &parsed.value))
		return false;
	settings_default(&scratch);
	if (settings_set(&scratch, parsed.index, &parsed.value) != NF_REFUSAL_NONE)
		return false;
	*change = parsed;
	return true;
}
