/* diff and dump, save, defaults and exit: all settings at once. */
#include "command_line/command.h"
#include "command_line/reply.h"
#include "storage/settings.h"
#include "storage/settings_store.h"
#include "storage/settings_text.h"

#include <string.h>

#define HEADER_ROWS 3u

/* --- diff and dump ---------------------------------------------------------------------------------------------- */
/* Lines before the settings: comments, and what makes the settings below the only ones that differ from the defaults. */
static void listing_header(const struct task_line *t, unsigned row)
{
	if (row == 2) {
		printer_text(t->out, "defaults");
	} else if (row == 1) {
		const char *const craft = t->services->settings->craft_name;
		printer_text(t->out, "# policy ");
		command_say_policy(t);
		printer_text(t->out, ", craft ");
		printer_part(t->out, craft[0] != '\0' ? craft : "-", NF_SETTING_TEXT_BYTES);
	} else {
		printer_text(t->out, "# ");
		command_say_version(t);
		printer_text(t->out, " on ");
		printer_text(t->out, t->services->identity->target);
	}
	printer_end(t->out);
}

/* Is it not at the default that it has beside the others? Bit by bit. */
static bool listing_differs(const struct nf_settings *settings, unsigned index)
{
	const struct setting *setting = settings_info_beside(settings, index);
	union setting_value value, preset;

	memset(&preset, 0, sizeof preset);
	preset.as_uint32_t = settings_limits(setting)->preset.as_uint32_t;
	settings_get(settings, index, &value);
	return memcmp(&value, &preset, sizeof value) != 0;
}

static void listing_setting(const struct task_line *t, unsigned index)
{
	const struct setting *setting = settings_info(index);
	union setting_value value;
	char text[SETTINGS_TEXT_BYTES];

	settings_get(t->services->settings, index, &value);
	settings_text_format(setting, &value, text);
	printer_text(t->out, "set ");
	printer_text(t->out, setting->name);
	printer_text(t->out, " = ");
	printer_text(t->out, text);
	printer_end(t->out);
}

/* rates_style stands before the rates, which it sets to its defaults: each line is one that the lines before it allow. */
static bool listing_row(const struct task_line *t, bool framed, bool all)
{
	const unsigned before = framed ? HEADER_ROWS : 0;

	if (t->row < before) {
		listing_header(t, t->row);
		return true;
	}
	const unsigned index = t->row - before;
	if (index < NF_SETTING_COUNT) {
		if (all || listing_differs(t->services->settings, index))
			listing_setting(t, index);
		return true;
	}
	if (framed) {
		printer_text(t->out, "# now 'save' keeps this, unless a line was refused");
		printer_end(t->out);
	}
	return false;
}

bool command_diff(const struct task_line *t)
{
	const bool all = command_is(t->arguments, "all");

	if (all || t->arguments[0] == '\0')
		return listing_row(t, all, false);
	command_got(t, "diff", t->arguments);
	printer_text(t->out, "nothing or 'all'");
	printer_end(t->out);
	return false;
}

bool command_dump(const struct task_line *t)
{
	return listing_row(t, true, true);
}

/* --- save, defaults, exit --------------------------------------------------------------------------------------- */
/* Ends the session with a restart, unless motors are under test. The words are the ones that configurators know. */
static void listing_restart(const struct task_line *t)
{
	if (t->services->reboot(t->services->context, NF_REBOOT_FIRMWARE) != NF_REFUSAL_NONE) {
		command_error(t);
		printer_text(t->out, "no restart: ");
		command_say_armed(t);
		return;
	}
	printer_text(t->out, "Rebooting");
	printer_end(t->out);
	command_line_leave(t->cl);
}

static void save_refuse(const struct task_line *t, const char *why)
{
	printer_text(t->out, COMMAND_ERROR "save: nothing written, ");
	printer_text(t->out, why);
	printer_end(t->out);
}

/* Writes to flash while nothing can arm. */
static enum nf_refusal save_write(const struct command_line_services *s)
{
	const enum nf_refusal refusal = s->storing(s->context, true);

	if (refusal != NF_REFUSAL_NONE)
		return refusal;
	const enum nf_refusal result = settings_save(s->settings, s->flash);
	(void)s->storing(s->context, false);
	return result;
}

static void save_conflict(const struct task_line *t)
{
	const struct setting *setting = settings_info(settings_conflict(t->services->settings));

	printer_text(t->out, COMMAND_ERROR "save: nothing written, ");
	printer_text(t->out, setting ? setting->name : "a setting");
	printer_text(t->out, " does not go with the settings beside it or with the policy; change it or those");
	printer_end(t->out);
}

bool command_save(const struct task_line *t)
{
	const bool force = command_is(t->arguments, "force");

	if (!force && t->arguments[0] != '\0') {
		command_got(t, "save", t->arguments);
		printer_text(t->out, "nothing or 'force'");
		printer_end(t->out);
		return false;
	}
	if (t->cl->failed && !force) {
		save_refuse(t, "for there were errors; 'save force' saves all the same, 'defaults' begins anew");
		return false;
	}
	switch (save_write(t->services)) {
	case NF_REFUSAL_NONE:
		printer_text(t->out, "saved");
		printer_end(t->out);
		listing_restart(t);
		break;
	case NF_REFUSAL_CONFLICT:
		save_conflict(t);
		break;
	case NF_REFUSAL_FLASH:
		save_refuse(t, "flash did not take it: what was stored before still holds; try again");
		break;
	default:
		save_refuse(t, "the motors are armed or under test: disarm, or wait until they rest");
		break;
	}
	return false;
}

bool command_defaults(const struct task_line *t)
{
	if (t->arguments[0] != '\0' && !command_is(t->arguments, "nosave")) {
		command_got(t, "defaults", t->arguments);
		printer_text(t->out, "nothing");
		printer_end(t->out);
	} else if (t->status->trace.armed) {
		command_error(t);
		printer_text(t->out, "defaults: ");
		command_say_armed(t);
	} else {
		settings_default(t->services->settings);
		t->cl->failed = false;
		printer_text(t->out,
			     "all settings are at their defaults, not saved: 'save' keeps that, 'exit' drops it");
		printer_end(t->out);
	}
	return false;
}

bool command_exit(const struct task_line *t)
{
	(void)settings_load(t->services->settings, t->services->flash);
	listing_restart(t);
	return false;
}
