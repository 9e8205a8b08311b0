/* diff and dump, save, defaults and exit: all settings at once. */
#include "command_line/command.h"
#include "storage/settings.h"
#include "storage/settings_store.h"
#include "storage/settings_text.h"

#include <string.h>

#define HEADER_ROWS 3u

/* --- diff and dump ---------------------------------------------------------------------------------------------- */
/* Lines before the settings: comments, and what makes the settings below the only ones that differ from the defaults. */
static void listing_header(const struct task_line *t, unsigned row)
{
	const char *const craft = t->services->settings->craft_name;

	if (row == 2) {
		printer_line(t->out, "defaults");
	} else if (row == 1) {
		printer_say(t->out, "# policy ");
		command_say_policy(t);
		printer_line(t->out, ", craft %.*s", NF_SETTING_TEXT_BYTES, craft[0] != '\0' ? craft : "-");
	} else {
		printer_line(t->out, "# " COMMAND_VERSION " on %s", t->services->identity->target);
	}
}

static void listing_setting(const struct task_line *t, unsigned index)
{
	const struct setting *setting = settings_info(index);
	union setting_value value;

	settings_get(t->services->settings, index, &value);
	printer_say(t->out, "set %s = ", setting->name);
	settings_text_print(t->out, setting, &value);
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
		if (all || !settings_is_default(t->services->settings, index))
			listing_setting(t, index);
		return true;
	}
	if (framed)
		printer_line(t->out, "# now 'save' keeps this, unless a line was refused");
	return false;
}

bool command_diff(const struct task_line *t)
{
	const bool all = command_is(t->arguments, "all");

	if (all || t->arguments[0] == '\0')
		return listing_row(t, all, false);
	command_got(t, "diff", t->arguments);
	printer_line(t->out, "nothing or 'all'");
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
		printer_line(t->out, "no restart: " COMMAND_ARMED);
		return;
	}
	printer_line(t->out, "Rebooting");
	command_line_leave(t->cl);
}

static void save_refuse(const struct task_line *t, const char *why)
{
	printer_line(t->out, COMMAND_ERROR "save: nothing written, %s", why);
}

/* Writes to flash while nothing can arm. */
static enum nf_refusal save_write(const struct services *s)
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

	printer_line(t->out,
		     COMMAND_ERROR
		     "save: nothing written, %s does not go with the settings beside it or with the policy; "
		     "change it or those",
		     setting ? setting->name : "a setting");
}

bool command_save(const struct task_line *t)
{
	const bool force = command_is(t->arguments, "force");

	if (!force && t->arguments[0] != '\0') {
		command_got(t, "save", t->arguments);
		printer_line(t->out, "nothing or 'force'");
		return false;
	}
	if (t->cl->failed && !force) {
		save_refuse(t, "for there were errors; 'save force' saves all the same, 'defaults' begins anew");
		return false;
	}
	switch (save_write(t->services)) {
	case NF_REFUSAL_NONE:
		printer_line(t->out, "saved");
		listing_restart(t);
		break;
	case NF_REFUSAL_CONFLICT:
		save_conflict(t);
		break;
	case NF_REFUSAL_FLASH:
		save_refuse(t, "flash did not take it: what was stored before still holds; try again");
		break;
	default:
		save_refuse(t, COMMAND_ARMED);
		break;
	}
	return false;
}

bool command_defaults(const struct task_line *t)
{
	if (t->arguments[0] != '\0' && !command_is(t->arguments, "nosave")) {
		command_got(t, "defaults", t->arguments);
		printer_line(t->out, "nothing");
	} else if (t->status->trace.armed) {
		command_error(t);
		printer_line(t->out, "defaults: " COMMAND_ARMED);
	} else {
		settings_default(t->services->settings);
		t->cl->failed = false;
		printer_line(t->out,
			     "all settings are at their defaults, not saved: 'save' keeps that, 'exit' drops it");
	}
	return false;
}

bool command_exit(const struct task_line *t)
{
	(void)settings_load(t->services->settings, t->services->flash);
	listing_restart(t);
	return false;
}
