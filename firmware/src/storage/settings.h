/* Settings (contract: SETTINGS): limits, defaults, and checks of combinations. */
#ifndef NF_SETTINGS_H
#define NF_SETTINGS_H

#include <stdint.h>

#include "nf_contract.h"

enum setting_kind { SETTING_uint32_t, SETTING_float };

/* Four bytes of one kind or the other. */
union setting_value {
	uint32_t as_uint32_t;
	float as_float;
};

/* What is known of a setting; `name` and `unit` are the contract's. */
struct setting {
	const char *name;
	const char *unit;
	enum setting_kind kind;
	union setting_value low, high, preset; /* of its kind; both limits may be taken */
};

/* A setting that this start has other than stored. */
struct setting_change {
	unsigned index;
	union setting_value value;
};

/* Every setting at its default. */
void settings_default(struct nf_settings *settings);

/* The setting of that index, in the order of the contract; NULL at NF_SETTING_COUNT and above. */
const struct setting *settings_info(unsigned index);

/* The same with the limits, default and unit that it has beside `settings`: rates have others in another style. */
const struct setting *settings_info_beside(const struct nf_settings *settings, unsigned index);

/* Index of the setting called `name`, NF_SETTING_COUNT if there is none. */
unsigned settings_find(const char *name);

/* Value of the setting `index` < NF_SETTING_COUNT, of the kind that settings_info tells. */
void settings_get(const struct nf_settings *settings, unsigned index, union setting_value *value);

/* Changes one setting; another style of rates sets all rates to the defaults of that style. NF_REFUSAL_INDEX: there is
 * none of that index. NF_REFUSAL_RANGE: beyond the limits that it has beside the others, or no number. A value that is refused changes nothing. Combinations are checked by settings_conflict. */
enum nf_refusal settings_set(struct nf_settings *settings, unsigned index, const union setting_value *value);

/* Index of the first setting that does not go with others or with this image's policy: a gyro rate that is none or
 * no multiple of the control rate; a filter at or above half the gyro rate; notch limits, battery limits or channels
 * that contradict each other; rates beyond the limits of their style; a baud rate that is none. NF_SETTING_COUNT: all go together. */
unsigned settings_conflict(const struct nf_settings *settings);

/* Sets to their defaults those that settings_conflict finds; all others are kept. */
void settings_mend(struct nf_settings *settings);

#endif
