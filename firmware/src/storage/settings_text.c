#include "storage/settings_text.h"

#include <string.h>

#include "common/decimal.h"
#include "nf_contract.h"
#include "storage/mode_range.h"

_Static_assert(SETTINGS_TEXT_BYTES > sizeof "blackbox aux12 1700 2100 and", "a mode range");
_Static_assert(SETTINGS_TEXT_BYTES > NF_SETTING_TEXT_BYTES + 2, "a text in quotes");

#define NO_TEXT '-'
#define QUOTE '"'

#define MODE_NAME(name) { NF_MODE_##name, #name },
static const struct {
	uint8_t mode;
	char name[9];
} modes[] = { NF_MODES(MODE_NAME) };

/* --- Words ---------------------------------------------------------------------------------------------------- */
static char settings_text_lower(char c)
{
	return c >= 'A' && c <= 'Z' ? (char)(c - 'A' + 'a') : c;
}

/* A word of a longer text. */
struct word {
	const char *at;
	size_t length;
};

static bool settings_text_is(struct word word, const char *name, size_t length)
{
	if (word.length != length)
		return false;
	for (size_t i = 0; i < length; ++i)
		if (settings_text_lower(word.at[i]) != settings_text_lower(name[i]))
			return false;
	return true;
}

/* Takes the word that *text begins with, spaces around it left out; an empty one at its end. */
static struct word settings_text_next(const char **text)
{
	while (**text == ' ')
		++*text;
	struct word word = { .at = *text };
	while (**text != ' ' && **text != '\0')
		++*text, ++word.length;
	while (**text == ' ')
		++*text;
	return word;
}

static bool settings_text_is_digit(char c)
{
	return c >= '0' && c <= '9';
}

/* Reads digits alone, up to 32 bits of them. */
static enum settings_text_error settings_text_whole(struct word word, uint32_t *value)
{
	uint64_t sum = 0;
	const bool negative = word.length > 1 && word.at[0] == '-';

	for (size_t i = negative; i < word.length; ++i) {
		if (!settings_text_is_digit(word.at[i]))
			return SETTINGS_TEXT_NOT_WHOLE;
		if (sum <= UINT32_MAX)
			sum = sum * 10u + (uint64_t)(word.at[i] - '0');
	}
	if (word.length == 0)
		return SETTINGS_TEXT_NOT_WHOLE;
	if (sum > UINT32_MAX || (negative && sum > 0))
		return SETTINGS_TEXT_TOO_LARGE;
	*value = (uint32_t)sum;
	return SETTINGS_TEXT_GOOD;
}

/* --- Choices -------------------------------------------------------------------------------------------------- */
/* Characters of the first of some choices. */
static size_t settings_text_choice_length(const char *choices)
{
	size_t length = 0;

	while (choices[length] != ',' && choices[length] != '\0')
		++length;
	return length;
}

static const char *settings_text_choice_after(const char *choices)
{
	choices += settings_text_choice_length(choices);
	return *choices == ',' ? choices + 1 : choices;
}

static enum settings_text_error settings_text_parse_choice(const struct setting *setting, struct word word,
							   uint32_t *value)
{
	uint32_t number = 0;

	if (settings_text_whole(word, &number) == SETTINGS_TEXT_GOOD &&
	    number <= settings_limits(setting)->high.as_uint32_t) {
		*value = number;
		return SETTINGS_TEXT_GOOD;
	}
	number = 0;
	for (const char *at = settings_choices(setting); *at != '\0'; at = settings_text_choice_after(at), ++number) {
		if (settings_text_is(word, at, settings_text_choice_length(at))) {
			*value = number;
			return SETTINGS_TEXT_GOOD;
		}
	}
	return SETTINGS_TEXT_NO_CHOICE;
}

/* --- Mode ranges ---------------------------------------------------------------------------------------------- */
static size_t settings_text_name_length(const char *name)
{
	size_t length = 0;

	while (length < sizeof modes[0].name && name[length] != '\0')
		++length;
	return length;
}

/* A range's end in steps. */
static enum settings_text_error settings_text_step(struct word word, uint8_t *step)
{
	uint32_t us;

	if (settings_text_whole(word, &us) != SETTINGS_TEXT_GOOD)
		return SETTINGS_TEXT_MODE_GRID;
	if (us < NF_MODE_LOW_US || us > NF_MODE_LOW_US + NF_MODE_STEPS * NF_MODE_STEP_US ||
	    (us - NF_MODE_LOW_US) % NF_MODE_STEP_US != 0)
		return SETTINGS_TEXT_MODE_GRID;
	*step = (uint8_t)((us - NF_MODE_LOW_US) / NF_MODE_STEP_US);
	return SETTINGS_TEXT_GOOD;
}

static enum settings_text_error settings_text_mode(struct word word, uint8_t *mode)
{
	for (size_t i = 0; i < sizeof modes / sizeof modes[0]; ++i) {
		if (settings_text_is(word, modes[i].name, settings_text_name_length(modes[i].name))) {
			*mode = modes[i].mode;
			return SETTINGS_TEXT_GOOD;
		}
	}
	return SETTINGS_TEXT_MODE_NAME;
}

static enum settings_text_error settings_text_aux(struct word word, uint8_t *aux)
{
	uint32_t number;

	if (word.length < 4 || !settings_text_is((struct word){ word.at, 3 }, "aux", 3) ||
	    settings_text_whole((struct word){ word.at + 3, word.length - 3 }, &number) != SETTINGS_TEXT_GOOD ||
	    number < 1 || number > NF_AUX_COUNT)
		return SETTINGS_TEXT_MODE_AUX;
	*aux = (uint8_t)(number - 1);
	return SETTINGS_TEXT_GOOD;
}

static enum settings_text_error settings_text_parse_mode(const char *text, uint32_t *value)
{
	const struct word name = settings_text_next(&text), aux = settings_text_next(&text),
			  low = settings_text_next(&text), high = settings_text_next(&text),
			  and = settings_text_next(&text);
	struct mode_range range = { .and_others = and.length > 0 };
	enum settings_text_error error;

	if (aux.length == 0 && settings_text_is(name, "none", 4)) {
		*value = 0;
		return SETTINGS_TEXT_GOOD;
	}
	if (high.length == 0 || *text != '\0' || (range.and_others && !settings_text_is(and, "and", 3)))
		return SETTINGS_TEXT_MODE_FORM;
	if ((error = settings_text_mode(name, &range.mode)) != SETTINGS_TEXT_GOOD ||
	    (error = settings_text_aux(aux, &range.aux)) != SETTINGS_TEXT_GOOD ||
	    (error = settings_text_step(low, &range.low)) != SETTINGS_TEXT_GOOD ||
	    (error = settings_text_step(high, &range.high)) != SETTINGS_TEXT_GOOD)
		return error;
	if (range.low > range.high)
		return SETTINGS_TEXT_MODE_ORDER;
	*value = mode_range_pack(&range);
	return SETTINGS_TEXT_GOOD;
}

/* --- Texts ---------------------------------------------------------------------------------------------------- */
/* What stands between quotes is the text, whatever it holds. */
static enum settings_text_error settings_text_parse_text(const char *text, union setting_value *value)
{
	union setting_value read;
	size_t length = 0;

	while (length <= NF_SETTING_TEXT_BYTES + 2 && text[length] != '\0')
		++length;
	if (length == 1 && text[0] == NO_TEXT)
		length = 0;
	if (length >= 2 && text[0] == QUOTE && text[length - 1] == QUOTE) {
		++text;
		length -= 2;
	}
	if (length > NF_SETTING_TEXT_BYTES)
		return SETTINGS_TEXT_TOO_LONG;
	memset(&read, 0, sizeof read);
	memcpy(read.as_text, text, length);
	*value = read;
	return SETTINGS_TEXT_GOOD;
}

/* --- Both ways ------------------------------------------------------------------------------------------------ */
enum settings_text_error settings_text_parse(const struct setting *setting, const char *text,
					     union setting_value *value)
{
	union setting_value read;
	enum settings_text_error error;
	const char *rest = text;
	struct word word;

	memset(&read, 0, sizeof read);
	switch ((enum setting_kind)setting->kind) {
	case SETTING_text:
		return settings_text_parse_text(text, value);
	case SETTING_float:
		error = decimal_parse(text, &read.as_float) ? SETTINGS_TEXT_GOOD : SETTINGS_TEXT_NO_NUMBER;
		break;
	case SETTING_mode:
		error = settings_text_parse_mode(text, &read.as_mode);
		break;
	case SETTING_uint32_t:
	default:
		word = settings_text_next(&rest);
		if (*rest != '\0')
			word.length += 1; /* a second word is part of no number and of no name */
		error = settings_choices(setting)[0] != '\0' ?
				settings_text_parse_choice(setting, word, &read.as_uint32_t) :
				settings_text_whole(word, &read.as_uint32_t);
		break;
	}
	if (error == SETTINGS_TEXT_GOOD)
		*value = read;
	return error;
}

static void settings_text_print_mode(struct printer *out, uint32_t packed)
{
	const struct mode_range range = mode_range_unpack(packed);

	if (packed == 0) {
		printer_say(out, "none");
		return;
	}
	for (size_t i = 0; i < sizeof modes / sizeof modes[0]; ++i)
		for (size_t k = 0; modes[i].mode == range.mode && k < settings_text_name_length(modes[i].name); ++k)
			printer_say(out, "%c", settings_text_lower(modes[i].name[k]));
	printer_say(out, " aux%u %u %u%s", range.aux + 1u, NF_MODE_LOW_US + range.low * NF_MODE_STEP_US,
		    NF_MODE_LOW_US + range.high * NF_MODE_STEP_US, range.and_others ? " and" : "");
}

static void settings_text_print_text(struct printer *out, const char text[NF_SETTING_TEXT_BYTES])
{
	int length = 0;

	while (length < NF_SETTING_TEXT_BYTES && text[length] != '\0')
		++length;
	const bool quoted = length > 0 && (text[0] == ' ' || text[0] == QUOTE || text[length - 1] == ' ' ||
					   (length == 1 && text[0] == NO_TEXT));
	if (length == 0)
		printer_say(out, "%c", NO_TEXT);
	else
		printer_say(out, quoted ? "\"%.*s\"" : "%.*s", length, text);
}

void settings_text_print(struct printer *out, const struct setting *setting, const union setting_value *value)
{
	const char *choices = settings_choices(setting);

	switch ((enum setting_kind)setting->kind) {
	case SETTING_text:
		settings_text_print_text(out, value->as_text);
		break;
	case SETTING_float:
		printer_float(out, value->as_float);
		/* 1 is written as 1.0, so that a ratio is not mistaken for a percentage. */
		if (value->as_float == 1.0f)
			printer_say(out, ".0");
		break;
	case SETTING_mode:
		settings_text_print_mode(out, value->as_mode);
		break;
	case SETTING_uint32_t:
		for (uint32_t before = value->as_uint32_t; before > 0 && choices[0] != '\0'; --before)
			choices = settings_text_choice_after(choices);
		if (settings_choices(setting)[0] != '\0')
			printer_say(out, "%.*s", (int)settings_text_choice_length(choices), choices);
		else
			printer_say(out, "%u", (unsigned)value->as_uint32_t);
		break;
	}
}
