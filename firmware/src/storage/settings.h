/* Settings (contract: SETTINGS): limits, defaults, and checks of combinations. */
#pragma once

#include "nf_contract.h"

/* Indices of the settings: SETTING_AT_<name>. */
#define SETTING_INDEX(name, kind, limits, unit, choices) SETTING_AT_##name,
enum setting_index { NF_SETTINGS(SETTING_INDEX) };

/* A value of one of the kinds. */
union setting_value {
	uint32_t as_uint32_t;
	float as_float;
	uint32_t as_mode;                     /* a packed range: mode_range.h */
	char as_text[NF_SETTING_TEXT_BYTES];  /* printable ASCII, then zeros */
};

/* A limit or a default; for a text, of its length. */
union setting_number {
	uint32_t as_uint32_t;
	float as_float;
	uint32_t as_mode;
	uint32_t as_text;
};

/* Description of a setting; kept small because there are many. */
struct setting {
	const char *name; /* the contract's */
	uint8_t offset;   /* of the value in struct nf_settings, in words */
	uint8_t kind : 2; /* enum setting_kind */
	uint8_t unit : 6; /* that settings_unit tells */
	uint8_t choices;  /* that settings_choices tells */
	uint8_t limits;   /* that settings_limits tells */
};

/* Limits (inclusive) and default, of the setting's kind; a text is empty by default. */
struct setting_limits {
	union setting_number low, high, preset;
};

/* A setting that this start has other than stored. */
struct setting_change {
	unsigned index;
	union setting_value value;
};

/* Returns the effective RC rate of the style betaflight. */
float settings_rc_rate(float rate);

/* Every setting at its default. */
void settings_default(struct nf_settings *settings);

/* The setting of that index, in the order of the contract; NULL at NF_SETTING_COUNT and above. */
const struct setting *settings_info(unsigned index);

/* The same with the limits, default and unit that it has beside `settings`: rates have others in another style. */
const struct setting *settings_info_beside(const struct nf_settings *settings, unsigned index);

/* Its limits and its default. */
const struct setting_limits *settings_limits(const struct setting *setting);

/* Its unit, as the contract has it. */
const char *settings_unit(const struct setting *setting);

/* Names of the values 0, 1, ..., separated by commas; "": it has none. */
const char *settings_choices(const struct setting *setting);

/* Index of the setting called `name`, NF_SETTING_COUNT if there is none. */
unsigned settings_find(const char *name);

/* Bytes of a value of this setting. */
size_t settings_size(const struct setting *setting);

/* Value of the setting `index` < NF_SETTING_COUNT, of the kind that settings_info tells; zeros behind its bytes. */
void settings_get(const struct nf_settings *settings, unsigned index, union setting_value *value);

/* That value of a whole number, a choice or a mode, and of a float. */
uint32_t settings_whole(const struct nf_settings *settings, unsigned index);
float settings_number(const struct nf_settings *settings, unsigned index);

/* Is it at the default that it has beside the others? Bit by bit. */
bool settings_is_default(const struct nf_settings *settings, unsigned index);

/* Changes one setting; another style of rates sets all rates to the defaults of that style. NF_REFUSAL_INDEX: there is
 * none of that index. NF_REFUSAL_RANGE: beyond the limits that it has beside the others, or no number. A value that is
 * refused changes nothing. Combinations are checked by settings_conflict. */
enum nf_refusal settings_set(struct nf_settings *settings, unsigned index, const union setting_value *value);

/* The same for a setting of whole numbers or a mode, and for one that is a float. */
enum nf_refusal settings_set_whole(struct nf_settings *settings, unsigned index, uint32_t number);
enum nf_refusal settings_set_number(struct nf_settings *settings, unsigned index, float number);

/* Index of the first setting that does not go with others or with this image's policy: a gyro rate that is none or
 * no multiple of the control rate; a filter at or above half the gyro rate; notch limits, battery limits or channels
 * that contradict each other; rates beyond the limits of their style; PID gains that want a faster chain of filters; two
 * motors on one output; a baud rate that is none. NF_SETTING_COUNT: all go together. */
unsigned settings_conflict(const struct nf_settings *settings);

/* Sets to their defaults those that settings_conflict finds; all others are kept. */
void settings_mend(struct nf_settings *settings);

/* Sets the settings that settings_conflict finds to their values in `before`, or to their defaults (NULL). They may
 * still conflict afterwards, for instance old rates with a new style. */
void settings_undo(struct nf_settings *settings, const struct nf_settings *before);
