#include "msp/msp_configure.h"

#include <stddef.h>

#include "blackbox/log_frames.h"
#include "common/limit.h"
#include "common/nf_math.h"
#include "housekeeping/battery.h"
#include "msp/msp_logs.h"
#include "policy.h"
#include "storage/settings.h"

#define BIT(number) (1u << (number))
#define ANY_ANGLE_DEG 180u
#define MIXER_QUAD_X 3u
#define MIXER_HEX_X 10u
#define MIXER_OTHER 23u

/* --- Features, receiver, arming, beeper -------------------------------------------------------------- */
static uint32_t sources_features(const struct nf_settings *s)
{
	const bool msp = s->receiver_protocol == NF_RECEIVER_PROTOCOL_MSP;

	return BIT(NF_MSP_FEATURE_AIRMODE) | BIT(msp ? NF_MSP_FEATURE_RX_MSP : NF_MSP_FEATURE_RX_SERIAL) |
	       (s->motor_stop ? BIT(NF_MSP_FEATURE_MOTOR_STOP) : 0u);
}

/* The provider tells which serial receiver it is; SBUS is the first of them. The bit of the blackbox is ignored: the
 * app derives it from the ports, which it sends too. */
static enum nf_refusal sources_set_features(struct nf_settings *s, uint32_t value)
{
	const uint32_t receivers = BIT(NF_MSP_FEATURE_RX_SERIAL) | BIT(NF_MSP_FEATURE_RX_MSP);
	const uint32_t changed = value ^ sources_features(s);

	if ((changed & receivers) == receivers) { /* one of them there must be */
		const bool msp = (value & BIT(NF_MSP_FEATURE_RX_MSP)) != 0;
		s->receiver_protocol = msp ? NF_RECEIVER_PROTOCOL_MSP : NF_RECEIVER_PROTOCOL_SBUS;
	}
	s->motor_stop = value >> NF_MSP_FEATURE_MOTOR_STOP & 1u;
	return ((value ^ sources_features(s)) & ~BIT(NF_MSP_FEATURE_BLACKBOX)) == 0 ? NF_REFUSAL_NONE :
										      NF_REFUSAL_PAYLOAD;
}

static uint32_t sources_provider(const struct nf_settings *s)
{
	return s->receiver_protocol == NF_RECEIVER_PROTOCOL_SBUS ? NF_MSP_PROVIDER_SBUS :
	       s->receiver_protocol == NF_RECEIVER_PROTOCOL_CRSF ? NF_MSP_PROVIDER_CRSF :
								   0u;
}

static enum nf_refusal sources_set_provider(struct nf_settings *s, uint32_t value)
{
	if (value != NF_MSP_PROVIDER_SBUS && value != NF_MSP_PROVIDER_CRSF)
		return NF_REFUSAL_PAYLOAD;
	return settings_set_whole(s, SETTING_AT_receiver_protocol,
				  value == NF_MSP_PROVIDER_SBUS ? NF_RECEIVER_PROTOCOL_SBUS :
								  NF_RECEIVER_PROTOCOL_CRSF);
}

static uint32_t sources_small_angle(const struct nf_settings *s)
{
	return s->level_limit_deg > 0.0f ? (uint32_t)(limit(s->level_limit_deg, 1.0f, 180.0f) + 0.5f) : ANY_ANGLE_DEG;
}

/* 0 would mean any angle to us, and to the ecosystem that nothing arms. */
static enum nf_refusal sources_set_small_angle(struct nf_settings *s, uint32_t value)
{
	if (value == 0)
		return NF_REFUSAL_RANGE;
	return settings_set_number(s, SETTING_AT_level_limit_deg, value == ANY_ANGLE_DEG ? 0.0f : (float)value);
}

/* Bits of the ecosystem's conditions that beep here too. All others but the one for the pilot's switch (9) are off. */
static const struct beep {
	uint8_t bit, setting;
} beeps[] = {
	{ 1, SETTING_AT_beep_receiver_lost }, { 3, SETTING_AT_beep_disarmed },     { 4, SETTING_AT_beep_armed },
	{ 6, SETTING_AT_beep_battery_low },   { 7, SETTING_AT_beep_battery_warn },
};
#define BEEPERS_ALL 0x7FFFFFu
#define BEEPER_OF_SWITCH BIT(9)

static uint32_t sources_beepers(const struct nf_settings *s)
{
	uint32_t off = BEEPERS_ALL & ~BEEPER_OF_SWITCH;

	for (size_t i = 0; i < sizeof beeps / sizeof beeps[0]; ++i)
		if (settings_whole(s, beeps[i].setting))
			off &= ~BIT(beeps[i].bit);
	return off;
}

static enum nf_refusal sources_set_beepers(struct nf_settings *s, uint32_t value)
{
	for (size_t i = 0; i < sizeof beeps / sizeof beeps[0]; ++i)
		(void)settings_set_whole(s, beeps[i].setting, (value & BIT(beeps[i].bit)) == 0);
	return sources_beepers(s) == value ? NF_REFUSAL_NONE : NF_REFUSAL_PAYLOAD;
}

/* --- Battery ------------------------------------------------------------------------------------------ */
/* The ecosystem's divider has tenths of a volt for whole numbers up to 255. */
static uint32_t sources_voltage(const struct msp_request *q, unsigned part)
{
	const float scale = battery_volts_scale(q->settings, q->services->identity);
	const float divider = scale <= 25.5f ? 10.0f : 2.0f;
	const float parts[] = { scale * divider, divider, 1.0f };

	return (uint32_t)(parts[part] + 0.5f);
}

enum nf_refusal msp_source_set_voltage(const struct msp_request *q, const uint8_t parts[3])
{
	struct nf_settings *s = q->settings;
	bool same = true;

	for (unsigned part = 0; part < 3; ++part)
		same &= parts[part] == sources_voltage(q, part);
	if (same)
		return NF_REFUSAL_NONE;
	if (parts[1] == 0 || parts[2] == 0)
		return NF_REFUSAL_RANGE;
	return settings_set_number(s, SETTING_AT_battery_scale, (float)parts[0] / ((float)parts[1] * (float)parts[2]));
}

static uint32_t sources_current(const struct msp_request *q)
{
	return (uint32_t)(battery_amps_scale(q->settings, q->services->identity) * 10.0f + 0.5f);
}

/* --- Rates ---------------------------------------------------------------------------------------------- */
#define RATE_EXPO 2u /* of the three of an axis */

static float sources_rate_gain(const struct nf_settings *s, unsigned which)
{
	return s->rates_style == NF_RATES_STYLE_ACTUAL && which % 3u != RATE_EXPO ? 0.1f : 100.0f;
}

static uint32_t sources_rate(const struct nf_settings *s, unsigned which)
{
	const float rate = settings_number(s, SETTING_AT_roll_rate + which);

	return (uint32_t)(limit(rate * sources_rate_gain(s, which), 0.0f, UINT8_MAX) + 0.5f);
}

static enum nf_refusal sources_set_rate(struct nf_settings *s, unsigned which, uint32_t value)
{
	return settings_set_number(s, SETTING_AT_roll_rate + which, (float)value / sources_rate_gain(s, which));
}

static enum nf_refusal sources_set_rates_type(struct nf_settings *s, uint32_t value)
{
	if (value != NF_MSP_RATES_BETAFLIGHT && value != NF_MSP_RATES_ACTUAL)
		return NF_REFUSAL_PAYLOAD;
	return settings_set_whole(s, SETTING_AT_rates_style,
				  value == NF_MSP_RATES_ACTUAL ? NF_RATES_STYLE_ACTUAL : NF_RATES_STYLE_BETAFLIGHT);
}

/* --- PID ------------------------------------------------------------------------------------------------ */
/* The ecosystem's number for the built-in gain times 1. */
static float sources_pid_built_in(const struct pid_gains *pid, unsigned which)
{
	static const float scales[] = NF_MSP_PID_SCALES;
	const unsigned axis = which / 3u, term = which % 3u;
	const float *const gains[] = { pid->p, pid->i, pid->d };

	return pid->motor_count == 0 ? 0.0f :
				       gains[term][axis] * ((float)NF_MSP_PID_SUM * NF_RAD_PER_DEG / scales[term]);
}

static uint32_t sources_pid(const struct msp_request *q, unsigned which)
{
	const float factor = settings_number(q->settings, SETTING_AT_pid_roll_p + which);

	return (uint32_t)(limit(sources_pid_built_in(q->services->pid, which) * factor, 0.0f, UINT8_MAX) + 0.5f);
}

static enum nf_refusal sources_set_pid(const struct msp_request *q, unsigned which, uint32_t value)
{
	const float built_in = sources_pid_built_in(q->services->pid, which);

	if (!(built_in > 0.0f))
		return NF_REFUSAL_PAYLOAD;
	return settings_set_number(q->settings, SETTING_AT_pid_roll_p + which, (float)value / built_in);
}

/* Cutoff of a low-pass from its gain, by Newton's method: gain = 1 - exp(-x). */
static uint32_t sources_d_lowpass(const struct pid_gains *pid)
{
	float x = pid->smoothing;

	if (pid->motor_count == 0 || pid->smoothing >= 1.0f)
		return 0;
	for (int i = 0; i < 8; ++i)
		x += (pid->smoothing - nf_one_minus_exp(x)) / (1.0f - nf_one_minus_exp(x));
	return (uint32_t)(limit(x * (float)POLICY_CONTROL_RATE_HZ / NF_TAU, 0.0f, UINT16_MAX) + 0.5f);
}

static uint32_t sources_tpa_rate(const struct pid_gains *pid)
{
	return (uint32_t)(limit(pid->tpa_slope * (1.0f - pid->tpa_breakpoint) * 100.0f, 0.0f, 100.0f) + 0.5f);
}

/* --- Filters: stages 1 and 2 are low-passes, 3 and 4 notches -------------------------------------------- */
#define STAGE_ROWS 3u /* kind, frequency, quality */
#define STAGE_HZ 1u
#define STAGE_Q 2u
#define LOWPASS_STAGES 2u
#define BUTTERWORTH_Q 0.70710678f
_Static_assert(SETTING_AT_filter2_kind - SETTING_AT_filter1_kind == STAGE_ROWS, "three settings a stage");

static const uint8_t lowpass_types[] = { NF_FILTER_PT1, NF_FILTER_BIQUAD, NF_FILTER_PT2, NF_FILTER_PT3 };
#define LOWPASS_TYPES (sizeof lowpass_types)

struct stage {
	unsigned index; /* of the setting that is its kind */
	uint32_t kind;
	float hz, q;
};

static struct stage sources_stage(const struct nf_settings *s, unsigned number)
{
	const unsigned index = SETTING_AT_filter1_kind + STAGE_ROWS * number;

	return (struct stage){ index, settings_whole(s, index), settings_number(s, index + STAGE_HZ),
			       settings_number(s, index + STAGE_Q) };
}

bool msp_filters_fit(const struct nf_settings *s)
{
	bool fit = true;

	for (unsigned number = 0; number < NF_FILTER_STAGES; ++number) {
		const struct stage stage = sources_stage(s, number);
		const bool butterworth = stage.q > 0.99f * BUTTERWORTH_Q && stage.q < 1.01f * BUTTERWORTH_Q;
		const bool notch = stage.kind == NF_FILTER_NOTCH;
		if (stage.kind != NF_FILTER_NONE)
			fit &= number < LOWPASS_STAGES ? !notch && (stage.kind != NF_FILTER_BIQUAD || butterworth) :
							 notch;
	}
	return fit;
}

static uint32_t sources_stage_hz(const struct nf_settings *s, unsigned number)
{
	const struct stage stage = sources_stage(s, number);

	return stage.kind == NF_FILTER_NONE ? 0u : (uint32_t)(stage.hz + 0.5f);
}

/* A stage that was none becomes one of `kind`. */
static enum nf_refusal sources_set_stage_hz(struct nf_settings *s, unsigned number, uint32_t value, uint32_t kind)
{
	const struct stage stage = sources_stage(s, number);

	if (value == 0)
		return settings_set_whole(s, stage.index, NF_FILTER_NONE);
	if (stage.kind == NF_FILTER_NONE)
		(void)settings_set_whole(s, stage.index, kind);
	return settings_set_number(s, stage.index + STAGE_HZ, (float)value);
}

static uint32_t sources_lowpass_type(const struct nf_settings *s, unsigned number)
{
	const struct stage stage = sources_stage(s, number);

	for (uint32_t type = 0; type < LOWPASS_TYPES; ++type)
		if (lowpass_types[type] == stage.kind)
			return type;
	return 0;
}

/* An unused stage has no type to keep. */
static enum nf_refusal sources_set_lowpass_type(struct nf_settings *s, unsigned number, uint32_t value)
{
	const struct stage stage = sources_stage(s, number);

	if (value >= LOWPASS_TYPES)
		return NF_REFUSAL_RANGE;
	if (stage.kind == NF_FILTER_NONE)
		return NF_REFUSAL_NONE;
	if (lowpass_types[value] == NF_FILTER_BIQUAD)
		(void)settings_set_number(s, stage.index + STAGE_Q, BUTTERWORTH_Q);
	return settings_set_whole(s, stage.index, lowpass_types[value]);
}

/* The lower edge f of a notch at c with quality q: q = c f / (c^2 - f^2). */
static uint32_t sources_notch_cutoff(const struct nf_settings *s, unsigned number)
{
	const struct stage stage = sources_stage(s, number);
	const float root = __builtin_sqrtf(1.0f + 4.0f * stage.q * stage.q);

	return stage.kind == NF_FILTER_NONE ? 0u : (uint32_t)(stage.hz * (root - 1.0f) / (2.0f * stage.q) + 0.5f);
}

static enum nf_refusal sources_set_notch_cutoff(struct nf_settings *s, unsigned number, uint32_t value)
{
	const struct stage stage = sources_stage(s, number);
	const float edge = (float)value;

	if (stage.kind == NF_FILTER_NONE)
		return NF_REFUSAL_NONE;
	if (value == 0 || edge >= stage.hz)
		return NF_REFUSAL_RANGE;
	return settings_set_number(s, stage.index + STAGE_Q, stage.hz * edge / (stage.hz * stage.hz - edge * edge));
}

/* --- Blackbox ------------------------------------------------------------------------------------------- */
#define FIELDS_OFF_KNOWN 0xFFFFu /* bits of groups that the ecosystem knows; those above are ours */

static uint32_t sources_log_rate(const struct nf_settings *s)
{
	return 31u - (uint32_t)__builtin_clz(s->blackbox_divider);
}

static enum nf_refusal sources_set_log_rate(struct nf_settings *s, uint32_t value)
{
	return value < 8 ? settings_set_whole(s, SETTING_AT_blackbox_divider, 1u << value) : NF_REFUSAL_RANGE;
}

static enum nf_refusal sources_set_fields_off(struct nf_settings *s, uint32_t value)
{
	if (value > FIELDS_OFF_KNOWN)
		return NF_REFUSAL_PAYLOAD;
	return settings_set_whole(s, SETTING_AT_blackbox_disabled_mask,
				  value | (s->blackbox_disabled_mask & ~FIELDS_OFF_KNOWN));
}

/* --- Gyro ------------------------------------------------------------------------------------------------- */
/* chip: enum gyro_chip + 1, 0: none that is known. */
static uint32_t sources_gyro_hardware(unsigned chip)
{
	static const uint8_t hardware[NF_MSP_GYRO_HARDWARE_COUNT] = NF_MSP_GYRO_HARDWARE;

	return chip == 0 ? 0 : hardware[chip - 1];
}

/* --- All of them ------------------------------------------------------------------------------------------ */
uint32_t msp_source_get(const struct msp_request *q, enum nf_msp_source source, unsigned argument)
{
	const struct nf_settings *s = q->settings;

	switch (source) {
	case NF_MSP_SOURCE_FEATURES:
		return sources_features(s);
	case NF_MSP_SOURCE_MIXER:
		return POLICY_ACTION_COUNT == 4 ? MIXER_QUAD_X : POLICY_ACTION_COUNT == 6 ? MIXER_HEX_X : MIXER_OTHER;
	case NF_MSP_SOURCE_MOTOR_COUNT:
		return POLICY_ACTION_COUNT;
	case NF_MSP_SOURCE_PROCESS_DENOMINATOR:
		return q->status->gyro_rate_hz / POLICY_CONTROL_RATE_HZ;
	case NF_MSP_SOURCE_IDLE:
		return (uint32_t)(limit(q->status->idle, 0.0f, 1.0f) * 10000.0f + 0.5f);
	case NF_MSP_SOURCE_SMALL_ANGLE:
		return sources_small_angle(s);
	case NF_MSP_SOURCE_PROVIDER:
		return sources_provider(s);
	case NF_MSP_SOURCE_RATES_TYPE:
		return s->rates_style == NF_RATES_STYLE_ACTUAL ? NF_MSP_RATES_ACTUAL : NF_MSP_RATES_BETAFLIGHT;
	case NF_MSP_SOURCE_RATE:
		return sources_rate(s, argument);
	case NF_MSP_SOURCE_PID:
		return sources_pid(q, argument);
	case NF_MSP_SOURCE_LOWPASS_HZ:
	case NF_MSP_SOURCE_NOTCH_HZ:
		return sources_stage_hz(s, argument);
	case NF_MSP_SOURCE_LOWPASS_TYPE:
		return sources_lowpass_type(s, argument);
	case NF_MSP_SOURCE_NOTCH_CUTOFF:
		return sources_notch_cutoff(s, argument);
	case NF_MSP_SOURCE_D_LOWPASS_HZ:
		return sources_d_lowpass(q->services->pid);
	case NF_MSP_SOURCE_TPA_RATE:
		return sources_tpa_rate(q->services->pid);
	case NF_MSP_SOURCE_TPA_BREAKPOINT:
		return NF_CHANNEL_MIN_US +
		       (uint32_t)(limit(q->services->pid->tpa_breakpoint, 0.0f, 1.0f) * 1000.0f + 0.5f);
	case NF_MSP_SOURCE_BEEPERS:
		return sources_beepers(s);
	case NF_MSP_SOURCE_DIVIDER:
		return sources_voltage(q, argument);
	case NF_MSP_SOURCE_CURRENT:
		return sources_current(q);
	case NF_MSP_SOURCE_LOG_RATE:
		return sources_log_rate(s);
	case NF_MSP_SOURCE_LOG_INTRA:
		return LOG_INTRA_INTERVAL / s->blackbox_divider;
	case NF_MSP_SOURCE_LOG_FIELDS_OFF:
		return s->blackbox_disabled_mask & FIELDS_OFF_KNOWN;
	case NF_MSP_SOURCE_LOG_CARD:
		return msp_log_card(q->services->blackbox, argument);
	case NF_MSP_SOURCE_GYRO_HARDWARE:
		return sources_gyro_hardware(q->status->gyro_chip);
	}
	return 0;
}

/* Read-only values: the app multiplies some by 0.01 and truncates what a binary fraction cannot represent. */
static enum nf_refusal sources_refuse(const struct msp_request *q, enum nf_msp_source source, unsigned argument,
				      uint32_t value)
{
	return value + 1u == msp_source_get(q, source, argument) && value > 0 &&
			       (source == NF_MSP_SOURCE_IDLE || source == NF_MSP_SOURCE_TPA_RATE) ?
		       NF_REFUSAL_NONE :
		       NF_REFUSAL_PAYLOAD;
}

enum nf_refusal msp_source_set(const struct msp_request *q, enum nf_msp_source source, unsigned argument,
			       uint32_t value)
{
	struct nf_settings *s = q->settings;

	switch (source) {
	case NF_MSP_SOURCE_FEATURES:
		return sources_set_features(s, value);
	case NF_MSP_SOURCE_SMALL_ANGLE:
		return sources_set_small_angle(s, value);
	case NF_MSP_SOURCE_PROVIDER:
		return sources_set_provider(s, value);
	case NF_MSP_SOURCE_RATES_TYPE:
		return sources_set_rates_type(s, value);
	case NF_MSP_SOURCE_RATE:
		return sources_set_rate(s, argument, value);
	case NF_MSP_SOURCE_PID:
		return sources_set_pid(q, argument, value);
	case NF_MSP_SOURCE_LOWPASS_HZ:
		return sources_set_stage_hz(s, argument, value, NF_FILTER_PT1);
	case NF_MSP_SOURCE_NOTCH_HZ:
		return sources_set_stage_hz(s, argument, value, NF_FILTER_NOTCH);
	case NF_MSP_SOURCE_LOWPASS_TYPE:
		return sources_set_lowpass_type(s, argument, value);
	case NF_MSP_SOURCE_NOTCH_CUTOFF:
		return sources_set_notch_cutoff(s, argument, value);
	case NF_MSP_SOURCE_BEEPERS:
		return sources_set_beepers(s, value);
	case NF_MSP_SOURCE_DIVIDER:
		return NF_REFUSAL_NONE; /* msp_source_set_voltage has taken all three together */
	case NF_MSP_SOURCE_CURRENT:
		return settings_set_number(s, SETTING_AT_current_scale, (float)value / 10.0f);
	case NF_MSP_SOURCE_LOG_RATE:
		return sources_set_log_rate(s, value);
	case NF_MSP_SOURCE_LOG_FIELDS_OFF:
		return sources_set_fields_off(s, value);
	default:
		return sources_refuse(q, source, argument, value);
	}
}
