/* get and set. */
#include "command_line/command.h"
#include "policy.h"
#include "storage/settings.h"
#include "storage/settings_text.h"

#define NAME_BYTES 33 /* longer than any setting's name */

/* --- What can be read, but not set ------------------------------------------------------------------------------ */
static void item_version(const struct task_line *t)
{
	printer_say(t->out, COMMAND_VERSION);
}

static void item_board(const struct task_line *t)
{
	printer_say(t->out, "%s", t->services->identity->target);
}

static void item_uid(const struct task_line *t)
{
	for (unsigned i = 0; i < 3; ++i)
		printer_say(t->out, "%08x", (unsigned)t->services->identity->unique_id[i]);
}

static void item_idle(const struct task_line *t)
{
	printer_fixed(t->out, t->services->slots->idle, 3);
}

static void item_mix(const struct task_line *t)
{
	printer_say(t->out, t->services->slots->mix == NF_MIX_CENTRED ? "centred" : "attitude-first");
}

static void item_control_rate(const struct task_line *t)
{
	printer_say(t->out, "%u", (unsigned)POLICY_CONTROL_RATE_HZ);
}

static const struct item {
	const char *name;
	void (*say)(const struct task_line *t);
} items[] = {
	{ "version", item_version },
	{ "board", item_board },
	{ "uid", item_uid },
	{ "policy", command_say_policy },
	{ "policy_idle", item_idle },
	{ "policy_mix", item_mix },
	{ "control_rate_hz", item_control_rate },
};
#define ITEM_COUNT (sizeof items / sizeof items[0])

static const struct item *item_find(const char *name)
{
	for (size_t i = 0; i < ITEM_COUNT; ++i)
		if (command_is(name, items[i].name))
			return &items[i];
	return NULL;
}

/* --- Words about a setting -------------------------------------------------------------------------------------- */
/* A limit or default of a number. */
static void setting_say_number(const struct task_line *t, const struct setting *setting, union setting_number number)
{
	const union setting_value value = { .as_uint32_t = number.as_uint32_t };

	settings_text_print(t->out, setting, &value);
}

/* Is its unit 1? Nobody says that. */
static bool setting_is_ratio(const struct setting *setting)
{
	return settings_unit(setting)[0] == '1' && settings_unit(setting)[1] == '\0';
}

/* Prints the possible values. */
static void setting_say_span(const struct task_line *t, const struct setting *setting)
{
	if (setting->kind == SETTING_text) {
		printer_say(t->out, "at most %u characters, - for none", NF_SETTING_TEXT_BYTES);
	} else if (setting->kind == SETTING_mode) {
		printer_say(t->out, "MODE AUX LOW HIGH such as arm aux1 1700 2100, perhaps 'and' behind it; none");
	} else if (settings_choices(setting)[0] != '\0') {
		printer_say(t->out, "one of %s", settings_choices(setting));
	} else {
		setting_say_number(t, setting, settings_limits(setting)->low);
		printer_say(t->out, " to ");
		setting_say_number(t, setting, settings_limits(setting)->high);
		if (!setting_is_ratio(setting))
			printer_say(t->out, " %s", settings_unit(setting));
	}
}

/* Prints the expected value after a text was refused with `error`. */
static void setting_say_expected(const struct task_line *t, const struct setting *setting,
				 enum settings_text_error error)
{
	switch (error) {
	case SETTINGS_TEXT_NOT_WHOLE:
		printer_say(t->out, "a whole number from ");
		break;
	case SETTINGS_TEXT_NO_NUMBER:
		printer_say(t->out, "a number from ");
		break;
	case SETTINGS_TEXT_MODE_NAME:
		printer_say(t->out, "a mode: arm, beeper, pid or trial");
		return;
	case SETTINGS_TEXT_MODE_AUX:
		printer_say(t->out, "aux1 to aux%u", NF_AUX_COUNT);
		return;
	case SETTINGS_TEXT_MODE_GRID:
		printer_say(t->out, "ends from %u to %u us, multiples of %u", NF_MODE_LOW_US,
			    NF_MODE_LOW_US + NF_MODE_STEPS * NF_MODE_STEP_US, NF_MODE_STEP_US);
		return;
	case SETTINGS_TEXT_MODE_ORDER:
		printer_say(t->out, "the lower end first");
		return;
	case SETTINGS_TEXT_GOOD:
	case SETTINGS_TEXT_TOO_LARGE:
	case SETTINGS_TEXT_NO_CHOICE:
	case SETTINGS_TEXT_TOO_LONG:
	case SETTINGS_TEXT_MODE_FORM:
		break;
	}
	setting_say_span(t, setting);
}

/* --- get -------------------------------------------------------------------------------------------------------- */
static bool get_has(const char *name, const char *part)
{
	for (;; ++name) {
		size_t same = 0;
		while (part[same] != '\0' && name[same] == part[same])
			++same;
		if (part[same] == '\0')
			return true;
		if (*name == '\0')
			return false;
	}
}

static void get_item(const struct task_line *t, const struct item *item)
{
	printer_say(t->out, "%s = ", item->name);
	item->say(t);
	printer_line(t->out, " (read-only)");
}

static void get_setting(const struct task_line *t, unsigned index)
{
	const struct setting *setting = settings_info_beside(t->services->settings, index);
	union setting_value value;

	settings_get(t->services->settings, index, &value);
	printer_say(t->out, "%s = ", setting->name);
	settings_text_print(t->out, setting, &value);
	printer_say(t->out, " (");
	setting_say_span(t, setting);
	if (setting->kind != SETTING_text) {
		printer_say(t->out, "; default ");
		setting_say_number(t, setting, settings_limits(setting)->preset);
	}
	printer_line(t->out, ")");
}

bool command_get(const struct task_line *t)
{
	if (t->row < ITEM_COUNT + NF_SETTING_COUNT) {
		const unsigned index = t->row < ITEM_COUNT ? t->row : t->row - (unsigned)ITEM_COUNT;
		const char *const name = t->row < ITEM_COUNT ? items[index].name : settings_info(index)->name;
		if (!get_has(name, t->arguments))
			return true;
		t->cl->found = true;
		if (t->row < ITEM_COUNT)
			get_item(t, &items[index]);
		else
			get_setting(t, index);
		return true;
	}
	if (!t->cl->found) {
		command_got(t, "get", t->arguments);
		printer_line(t->out, "a part of a name; 'get' alone lists all");
	}
	return false;
}

/* --- set -------------------------------------------------------------------------------------------------------- */
/* Copies the name before '='. Returns what stands behind that and spaces; NULL: there is no '='. */
static const char *set_split(const char *text, char name[NAME_BYTES])
{
	size_t length = 0;

	for (; *text != '\0' && *text != '=' && *text != ' '; ++text)
		if (length + 1 < NAME_BYTES)
			name[length++] = *text;
	name[length] = '\0';
	while (*text == ' ')
		++text;
	if (*text != '=')
		return NULL;
	do
		++text;
	while (*text == ' ');
	return text;
}

static void set_refuse_name(const struct task_line *t, const char *name)
{
	command_got(t, "set", name);
	printer_line(t->out, "%s" COMMAND_FOREIGN,
		     item_find(name) ? "a setting; that can only be read" :
				       "a setting's name; 'get' lists them, 'get PART' finds them");
}

/* Is `text` a bare 1 of a setting from 0 to 1? Betaflight has percents under the same names, where 1 means 0.01. */
static bool set_is_percent(unsigned index, const char *text)
{
	const struct setting *setting = settings_info(index);
	const struct setting_limits *limits = settings_limits(setting);

	return setting->kind == SETTING_float && limits->low.as_float == 0.0f && limits->high.as_float == 1.0f &&
	       command_is(text, "1");
}

static void set_value(const struct task_line *t, unsigned index, const char *text)
{
	const struct setting *setting = settings_info_beside(t->services->settings, index);
	union setting_value value;
	const enum settings_text_error error = settings_text_parse(setting, text, &value);

	if (set_is_percent(index, text)) {
		command_got(t, setting->name, text);
		printer_line(t->out, "1.0, or 0.01 for a percent" COMMAND_FOREIGN);
		return;
	}
	if (error == SETTINGS_TEXT_GOOD && settings_set(t->services->settings, index, &value) == NF_REFUSAL_NONE)
		return;
	command_got(t, setting->name, text);
	setting_say_expected(t, setting, error);
	printer_end(t->out);
}

bool command_set(const struct task_line *t)
{
	char name[NAME_BYTES];
	const char *const value = set_split(t->arguments, name);

	if (t->arguments[0] == '\0')
		return command_get(t);
	const unsigned index = settings_find(name);
	if (t->status->trace.armed) {
		command_error(t);
		printer_line(t->out, "set: " COMMAND_ARMED);
	} else if (index == NF_SETTING_COUNT) {
		set_refuse_name(t, name);
	} else if (!value) {
		command_got(t, "set", t->arguments);
		printer_line(t->out, "NAME = VALUE; 'get %s' tells the value", name);
	} else {
		set_value(t, index, value);
	}
	return false;
}
