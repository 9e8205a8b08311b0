/* A setting's value as people write it, and back, exactly. */
#pragma once

#include "common/printer.h"
#include "storage/settings.h"

#define SETTINGS_TEXT_BYTES 32 /* of the longest value, its end included */

/* Errors of a text that is not a valid value of a setting, in the order of the checks. */
enum settings_text_error {
	SETTINGS_TEXT_GOOD,
	SETTINGS_TEXT_NO_NUMBER,   /* of a float, decimal_parse */
	SETTINGS_TEXT_NOT_WHOLE,   /* digits alone */
	SETTINGS_TEXT_TOO_LARGE,   /* a whole number that is negative or has more than 32 bits */
	SETTINGS_TEXT_NO_CHOICE,
	SETTINGS_TEXT_TOO_LONG,    /* more than NF_SETTING_TEXT_BYTES characters */
	SETTINGS_TEXT_MODE_FORM,   /* not `MODE AUX LOW HIGH`, perhaps ` and`, or `none` */
	SETTINGS_TEXT_MODE_NAME,   /* no mode of that name */
	SETTINGS_TEXT_MODE_AUX,    /* not aux1 to the last */
	SETTINGS_TEXT_MODE_GRID,   /* an end that is no multiple of NF_MODE_STEP_US, or beyond the range */
	SETTINGS_TEXT_MODE_ORDER,  /* the low end is above the high one */
};

/* Prints a value of `setting`: a choice by name; a float with the fewest digits that read back; a mode range as
 * `arm aux1 1700 2100`, ` and` behind it or not, none: 0; a text as it is, `-` for none, in quotes where it would read
 * as another otherwise. Takes less than SETTINGS_TEXT_BYTES. */
void settings_text_print(struct printer *out, const struct setting *setting, const union setting_value *value);

/* Reads one. Names count whatever their case; a choice may be told by its number, too. Beyond what its form says a value
 * is not checked: settings_set does. An error leaves *value as it is. */
enum settings_text_error settings_text_parse(const struct setting *setting, const char *text,
					     union setting_value *value);
