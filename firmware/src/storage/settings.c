#include "storage/settings.h"

#include <string.h>

#include "policy.h"
#include "storage/mode_range.h"

#define FACTS(name_, kind_, limits_, unit_, choices_)                       \
	{ .name = #name_,                                                   \
	  .offset = offsetof(struct nf_settings, name_) / sizeof(uint32_t), \
	  .kind = SETTING_##kind_,                                          \
	  .unit = unit_,                                                    \
	  .choices = choices_,                                              \
	  .limits = limits_ }
#define ROW(name, ...) [SETTING_AT_##name] = FACTS(name, __VA_ARGS__),
static const struct setting table[] = { NF_SETTINGS(ROW) };

#define RATES_FIRST SETTING_AT_roll_rate
#define RATES_LAST SETTING_AT_yaw_expo
#define ROW_OF_RATES(name, ...) [SETTING_AT_##name - RATES_FIRST] = FACTS(name, __VA_ARGS__),
static const struct setting betaflight[] = { NF_SETTINGS_BETAFLIGHT(ROW_OF_RATES) };

_Static_assert(sizeof table / sizeof table[0] == NF_SETTING_COUNT, "a row each");
_Static_assert(sizeof betaflight / sizeof betaflight[0] == RATES_LAST - RATES_FIRST + 1, "the rates, side by side");
_Static_assert(SETTING_AT_rates_style < RATES_FIRST, "loading takes the style before the rates that it sets");

const struct setting *settings_info(unsigned index)
{
	return index < NF_SETTING_COUNT ? &table[index] : NULL;
}

const struct setting *settings_info_beside(const struct nf_settings *settings, unsigned index)
{
	if (index >= RATES_FIRST && index <= RATES_LAST && settings->rates_style == NF_RATES_STYLE_BETAFLIGHT)
		return &betaflight[index - RATES_FIRST];
	return settings_info(index);
}

const struct setting_limits *settings_limits(const struct setting *setting)
{
#define LIMITS(kind_, low_, high_, preset_) \
	{ .low = { .as_##kind_ = (low_) }, .high = { .as_##kind_ = (high_) }, .preset = { .as_##kind_ = (preset_) } },
	static const struct setting_limits limits[] = { NF_SETTING_LIMITS(LIMITS) };
	_Static_assert(NF_SETTING_LIMITS_COUNT <= UINT8_MAX + 1, "an index fits");

	return &limits[setting->limits];
}

const char *settings_unit(const struct setting *setting)
{
	static const char *const units[] = NF_SETTING_UNITS;

	return units[setting->unit];
}

const char *settings_choices(const struct setting *setting)
{
	static const char *const choices[] = NF_SETTING_CHOICES;

	return choices[setting->choices];
}

static bool settings_same_name(const char *a, const char *b)
{
	while (*a && *a == *b)
		a++, b++;
	return *a == *b;
}

unsigned settings_find(const char *name)
{
	unsigned index = 0;

	while (index < NF_SETTING_COUNT && !settings_same_name(table[index].name, name))
		++index;
	return index;
}

size_t settings_size(const struct setting *setting)
{
	return setting->kind == SETTING_text ? NF_SETTING_TEXT_BYTES : sizeof(uint32_t);
}

void settings_get(const struct nf_settings *settings, unsigned index, union setting_value *value)
{
	const struct setting *setting = &table[index];

	memset(value, 0, sizeof *value);
	memcpy(value, (const uint32_t *)settings + setting->offset, settings_size(setting));
}

uint32_t settings_whole(const struct nf_settings *settings, unsigned index)
{
	return ((const uint32_t *)settings)[table[index].offset];
}

float settings_number(const struct nf_settings *settings, unsigned index)
{
	union setting_value value;

	settings_get(settings, index, &value);
	return value.as_float;
}

static void settings_put(struct nf_settings *settings, unsigned index, const union setting_value *value)
{
	const struct setting *setting = &table[index];

	memcpy((uint32_t *)settings + setting->offset, value, settings_size(setting));
}

/* The default that the setting has beside the others. */
static void settings_preset(const struct nf_settings *settings, unsigned index, union setting_value *value)
{
	memset(value, 0, sizeof *value);
	value->as_uint32_t = settings_limits(settings_info_beside(settings, index))->preset.as_uint32_t;
}

bool settings_is_default(const struct nf_settings *settings, unsigned index)
{
	union setting_value value, preset;

	settings_preset(settings, index, &preset);
	settings_get(settings, index, &value);
	return memcmp(&value, &preset, sizeof value) == 0;
}

static void settings_put_defaults(struct nf_settings *settings, unsigned first, unsigned last)
{
	for (unsigned index = first; index <= last; ++index) {
		union setting_value value;
		settings_preset(settings, index, &value);
		settings_put(settings, index, &value);
	}
}

void settings_default(struct nf_settings *settings)
{
	settings_put_defaults(settings, 0, NF_SETTING_COUNT - 1);
}

/* Printable ASCII, then zeros. */
static bool settings_printable(const char text[NF_SETTING_TEXT_BYTES])
{
	unsigned length = 0;

	while (length < NF_SETTING_TEXT_BYTES && text[length] >= ' ' && text[length] <= '~')
		++length;
	while (length < NF_SETTING_TEXT_BYTES && text[length] == '\0')
		++length;
	return length == NF_SETTING_TEXT_BYTES;
}

/* Any NaN says no. */
static bool settings_within(const struct setting *setting, const union setting_value *value)
{
	const struct setting_limits *limits = settings_limits(setting);

	switch ((enum setting_kind)setting->kind) {
	case SETTING_float:
		return value->as_float >= limits->low.as_float && value->as_float <= limits->high.as_float;
	case SETTING_mode:
		return mode_range_good(value->as_mode);
	case SETTING_text:
		return settings_printable(value->as_text);
	case SETTING_uint32_t:
		break;
	}
	return value->as_uint32_t >= limits->low.as_uint32_t && value->as_uint32_t <= limits->high.as_uint32_t;
}

enum nf_refusal settings_set(struct nf_settings *settings, unsigned index, const union setting_value *value)
{
	if (index >= NF_SETTING_COUNT)
		return NF_REFUSAL_INDEX;
	const struct setting *setting = settings_info_beside(settings, index);
	union setting_value kept = *value;

	if (setting->kind == SETTING_float && kept.as_float < NF_SETTING_LEAST && kept.as_float > -NF_SETTING_LEAST)
		kept.as_float = 0.0f; /* a smaller number has no text that reads back */
	if (!settings_within(setting, &kept))
		return NF_REFUSAL_RANGE;
	const uint32_t style = settings->rates_style;
	settings_put(settings, index, &kept);
	if (settings->rates_style != style) /* the same numbers mean another thing in another style */
		settings_put_defaults(settings, RATES_FIRST, RATES_LAST);
	return NF_REFUSAL_NONE;
}

enum nf_refusal settings_set_whole(struct nf_settings *settings, unsigned index, uint32_t number)
{
	union setting_value value;

	memset(&value, 0, sizeof value);
	value.as_uint32_t = number;
	return settings_set(settings, index, &value);
}

enum nf_refusal settings_set_number(struct nf_settings *settings, unsigned index, float number)
{
	union setting_value value;

	memset(&value, 0, sizeof value);
	value.as_float = number;
	return settings_set(settings, index, &value);
}

/* --- What settings may not be together -------------------------------------------------------------- */
static bool settings_is_one_of(uint32_t value, const uint32_t known[], size_t count)
{
	for (size_t i = 0; i < count; ++i)
		if (known[i] == value)
			return true;
	return false;
}
#define IS_ONE_OF(value, known) settings_is_one_of(value, known, sizeof(known) / sizeof(known)[0])

static bool settings_msp_baud_fits(const struct nf_settings *settings, unsigned first)
{
	static const uint32_t known[] = NF_MSP_BAUDS;

	return IS_ONE_OF(settings_whole(settings, first), known);
}

static bool settings_log_baud_fits(const struct nf_settings *settings, unsigned first)
{
	static const uint32_t known[] = NF_LOG_BAUDS;

	return IS_ONE_OF(settings_whole(settings, first), known);
}

static bool settings_log_divider_fits(const struct nf_settings *settings, unsigned first)
{
	static const uint32_t known[] = NF_LOG_DIVIDERS;

	return IS_ONE_OF(settings_whole(settings, first), known);
}

static bool settings_gyro_rate_fits(const struct nf_settings *settings, unsigned first)
{
	static const uint32_t known[] = NF_GYRO_RATES_HZ;
	const uint32_t rate_hz = settings_whole(settings, first);

	return IS_ONE_OF(rate_hz, known) && rate_hz % POLICY_CONTROL_RATE_HZ == 0;
}

/* Does `hz` lie below half the gyro rate, above which a filter of samples has no meaning? */
static bool settings_below_nyquist(const struct nf_settings *settings, float hz)
{
	return hz * 2.0f < (float)settings->gyro_rate_hz;
}

/* `first`: the kind of a stage, behind which its frequency stands. */
static bool settings_filter_fits(const struct nf_settings *settings, unsigned first)
{
	return settings_whole(settings, first) == NF_FILTER_NONE ||
	       settings_below_nyquist(settings, settings_number(settings, first + 1));
}

static bool settings_dynamic_notch_fits(const struct nf_settings *settings, unsigned first)
{
	return settings->dynamic_notch_low_hz < settings->dynamic_notch_high_hz &&
	       (settings->dynamic_notch_count == 0 ||
		settings_below_nyquist(settings, settings->dynamic_notch_high_hz));
}

#define TURN 6.2831853f /* rad */

/* Delay of a first-order low-pass of 1 rad/s in seconds, times that of a stage of quality q; for slow motion, but of a
 * low-pass that rings, at its cutoff. PT2 and PT3 have the cutoff that filters.c corrects. */
static float settings_slowness(uint32_t kind, float q)
{
	switch (kind) {
	case NF_FILTER_PT1:
		return 1.0f;
	case NF_FILTER_PT2:
		return 2.0f / 1.55377397f;
	case NF_FILTER_PT3:
		return 3.0f / 1.96145918f;
	case NF_FILTER_BIQUAD:
		return 2.0f * q > 1.0f / q ? 2.0f * q : 1.0f / q;
	case NF_FILTER_NOTCH:
		return 1.0f / q;
	default:
		return 0.0f;
	}
}

/* Of the whole chain, for slow motion. A mean that is left to the policy comes alone, which is fast enough, or behind the
 * notches on the rotors' turns, with which it is counted. */
static float settings_filter_delay_s(const struct nf_settings *settings)
{
	const bool notches = settings->motor_telemetry && settings->rpm_filter_harmonics > 0;
	float delay_s = (float)settings->dynamic_notch_count /
			(TURN * settings->dynamic_notch_low_hz * settings->dynamic_notch_q);

	for (uint32_t i = 1; notches && i <= settings->rpm_filter_harmonics; ++i)
		delay_s += (float)POLICY_ACTION_COUNT /
			   (TURN * (float)i * settings->rpm_filter_min_hz * settings->rpm_filter_q);

	for (unsigned stage = SETTING_AT_filter1_kind; stage < SETTING_AT_dynamic_notch_count; stage += 3)
		delay_s += settings_slowness(settings_whole(settings, stage), settings_number(settings, stage + 2)) /
			   (TURN * settings_number(settings, stage + 1));
	if (settings->gyro_mean == NF_GYRO_MEAN_ON || notches) /* its samples are half of its span old, on average */
		delay_s += 0.5f / (float)POLICY_CONTROL_RATE_HZ - 0.5f / (float)settings->gyro_rate_hz;
	return delay_s;
}

/* Returns whether the filter chain is fast enough for the standby PID. */
static bool settings_filter_delay_fits(const struct nf_settings *settings, unsigned first)
{
	return settings_filter_delay_s(settings) <= 0.001f * NF_FILTER_DELAY_MAX_MS;
}

/* Gains other than the built-in ones have less margin for delay. */
static bool settings_pid_fits(const struct nf_settings *settings, unsigned first)
{
	bool built_in = true;

	for (unsigned index = first; index <= SETTING_AT_pid_yaw_d; ++index)
		built_in &= settings_number(settings, index) == 1.0f;
	return built_in || settings_filter_delay_s(settings) <= 0.001f * NF_PID_FACTOR_FILTER_DELAY_MAX_MS;
}
_Static_assert(SETTING_AT_dynamic_notch_count - SETTING_AT_filter1_kind == 3 * NF_FILTER_STAGES, "three each");

/* Each channel of the receiver may be mapped once: one bit for each channel seen. */
static bool settings_map_fits(const struct nf_settings *settings, unsigned first)
{
	uint32_t met = 0;

	_Static_assert(NF_CHANNEL_MAPPED_COUNT <= 32, "a bit each");
	for (unsigned index = first; index <= SETTING_AT_map_aux4; ++index) {
		const uint32_t bit = 1u << settings_whole(settings, index);
		if (met & bit)
			return false;
		met |= bit;
	}
	return true;
}

static bool settings_rates_fit(const struct nf_settings *settings, unsigned first)
{
	for (unsigned index = RATES_FIRST; index <= RATES_LAST; ++index) {
		union setting_value rate;
		settings_get(settings, index, &rate);
		if (!settings_within(settings_info_beside(settings, index), &rate))
			return false;
	}
	return true;
}

float settings_rc_rate(float rate)
{
	const float steep = rate - NF_RC_RATE_STEEP;

	return steep > 0.0f ? rate + NF_RC_RATE_STEEPER * steep : rate;
}

/* Does a full stick ask for no more than is flown? `first`: the rate of an axis, behind which its max stands. Half a degree
 * is the rounding of numbers that pilots know with two decimals. */
static bool settings_full_stick_fits(const struct nf_settings *settings, unsigned first)
{
	if (settings->rates_style != NF_RATES_STYLE_BETAFLIGHT)
		return true; /* each number has its limit */
	const float room = 1.0f - settings_number(settings, first + 1);
	return NF_RC_RATE_DEG_S * settings_rc_rate(settings_number(settings, first)) <=
	       (NF_RATE_MAX_DEG_S + 0.5f) * (room > NF_SUPER_ROOM_MIN ? room : NF_SUPER_ROOM_MIN);
}

static bool settings_battery_fits(const struct nf_settings *settings, unsigned first)
{
	return settings->battery_low_v < settings->battery_warn_v;
}

static bool settings_failsafe_fits(const struct nf_settings *settings, unsigned first)
{
	return settings->failsafe_hold_ms < settings->failsafe_delay_ms;
}

/* Every motor has its own output among the first POLICY_ACTION_COUNT outputs. */
static bool settings_outputs_fit(const struct nf_settings *settings, unsigned first)
{
	uint32_t met = 0;

	for (unsigned motor = 0; motor < POLICY_ACTION_COUNT; ++motor)
		met |= 1u << (settings_whole(settings, first + motor) - 1u);
	return met == (1u << POLICY_ACTION_COUNT) - 1u;
}

/* The gyro rate comes first: other settings are checked against it. */
static const struct rule {
	bool (*fits)(const struct nf_settings *settings, unsigned first);
	unsigned first, last; /* the settings that it is about */
} rules[] = {
	{ settings_gyro_rate_fits, SETTING_AT_gyro_rate_hz, SETTING_AT_gyro_rate_hz },
	{ settings_filter_fits, SETTING_AT_filter1_kind, SETTING_AT_filter1_q },
	{ settings_filter_fits, SETTING_AT_filter2_kind, SETTING_AT_filter2_q },
	{ settings_filter_fits, SETTING_AT_filter3_kind, SETTING_AT_filter3_q },
	{ settings_filter_fits, SETTING_AT_filter4_kind, SETTING_AT_filter4_q },
	{ settings_dynamic_notch_fits, SETTING_AT_dynamic_notch_count, SETTING_AT_dynamic_notch_high_hz },
	{ settings_filter_delay_fits, SETTING_AT_filter1_kind, SETTING_AT_gyro_mean },
	{ settings_pid_fits, SETTING_AT_pid_roll_p, SETTING_AT_pid_yaw_d },
	{ settings_map_fits, SETTING_AT_map_roll, SETTING_AT_map_aux4 },
	{ settings_rates_fit, SETTING_AT_rates_style, RATES_LAST },
	{ settings_full_stick_fits, SETTING_AT_roll_rate, SETTING_AT_roll_expo },
	{ settings_full_stick_fits, SETTING_AT_pitch_rate, SETTING_AT_pitch_expo },
	{ settings_full_stick_fits, SETTING_AT_yaw_rate, SETTING_AT_yaw_expo },
	{ settings_battery_fits, SETTING_AT_battery_warn_v, SETTING_AT_battery_low_v },
	{ settings_failsafe_fits, SETTING_AT_failsafe_hold_ms, SETTING_AT_failsafe_delay_ms },
	{ settings_msp_baud_fits, SETTING_AT_msp_baud, SETTING_AT_msp_baud },
	{ settings_msp_baud_fits, SETTING_AT_uart3_baud, SETTING_AT_uart3_baud },
	{ settings_log_baud_fits, SETTING_AT_blackbox_baud, SETTING_AT_blackbox_baud },
	{ settings_log_divider_fits, SETTING_AT_blackbox_divider, SETTING_AT_blackbox_divider },
	{ settings_outputs_fit, SETTING_AT_motor1_output, SETTING_AT_motor8_output },
};
_Static_assert(SETTING_AT_map_aux4 - SETTING_AT_map_roll == NF_CHANNEL_MAPPED_COUNT - 1,
	       "all of the map, side by side");
_Static_assert(NF_FILTER_STAGES == 4, "a rule each");
_Static_assert(SETTING_AT_motor8_output - SETTING_AT_motor1_output == NF_MOTOR_COUNT_MAX - 1, "side by side");

unsigned settings_conflict(const struct nf_settings *settings)
{
	for (size_t i = 0; i < sizeof rules / sizeof rules[0]; ++i)
		if (!rules[i].fits(settings, rules[i].first))
			return rules[i].first;
	return NF_SETTING_COUNT;
}

void settings_undo(struct nf_settings *settings, const struct nf_settings *before)
{
	for (size_t i = 0; i < sizeof rules / sizeof rules[0]; ++i) {
		const unsigned first = rules[i].first, last = rules[i].last;
		const size_t at = table[first].offset, end = table[last].offset + 1u; /* no text is among them */
		if (rules[i].fits(settings, first))
			continue;
		if (before)
			memcpy((uint32_t *)settings + at, (const uint32_t *)before + at, (end - at) * sizeof(uint32_t));
		else
			settings_put_defaults(settings, first, last);
	}
}

void settings_mend(struct nf_settings *settings)
{
	settings_undo(settings, NULL);
}
