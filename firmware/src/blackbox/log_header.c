#include "blackbox/log_header.h"

#include <string.h>

#include "common/crc32.h"
#include "common/printer.h"
#include "policy.h"
#include "storage/settings_text.h"

#define STATE_LINE_BYTES ((NF_LOG_HEADER_LINE_MAX - (sizeof "H nf_state_000:\n" - 1u)) / 2u)
#define CENTI 100.0f
#define TEXT(number) TEXT_OF(number)
#define TEXT_OF(number) #number

static unsigned header_centi(float value)
{
	return (unsigned)(value * CENTI + 0.5f);
}

/* --- The ecosystem's lines --------------------------------------------------------------------------------------- */
/* Rates as its settings have them, whole: 0 rate, 1 max, 2 expo. */
static void header_rates(struct printer *out, const struct nf_settings *s, unsigned which)
{
	const bool tens = s->rates_style == NF_RATES_STYLE_ACTUAL && which != 2;

	for (unsigned axis = 0; axis < 3; ++axis) {
		const float value = settings_number(s, SETTING_AT_roll_rate + 3 * axis + which);
		printer_say(out, axis > 0 ? ",%u" : "%u", (unsigned)(value * (tens ? 0.1f : CENTI) + 0.5f));
	}
}

/* --- Ours -------------------------------------------------------------------------------------------------------- */
/* Build and CRC of the image. */
static void header_image(struct printer *out, const struct log_about *about)
{
	printer_bytes(out, about->image.build, sizeof about->image.build);
	printer_say(out, ",%08x", (unsigned)about->image.crc);
}

/* Source, sequence, architecture and SHA-256 of the policy that is flown. */
static void header_policy(struct printer *out, const struct log_about *about)
{
	struct nf_policy_blob_header header;

	printer_say(out, "%u", about->slots->flown);
	if (!policy_slots_header(about->slots, &header))
		return;
	printer_say(out, ",%u,%08x,", (unsigned)header.sequence, (unsigned)header.architecture_hash);
	printer_bytes(out, header.policy_sha256, sizeof header.policy_sha256);
}

static void header_aircraft(struct printer *out, const struct log_about *about)
{
	struct nf_policy_blob_header header;

	if (policy_slots_header(about->slots, &header))
		printer_say(out, "%.*s", (int)sizeof header.aircraft, header.aircraft);
}

/* Writes each term of the observation: block, age in steps, gain of its low-pass. */
static void header_observation(struct printer *out)
{
	for (unsigned i = 0; i < POLICY_OBSERVATION_TERM_COUNT; ++i) {
		printer_say(out, i > 0 ? ",%u@%u~" : "%u@%u~", policy_observation_blocks[i],
			    policy_observation_ages[i]);
		printer_float(out, policy_observation_gains[i]);
	}
}

static void header_idle(struct printer *out, const struct log_about *about)
{
	printer_float(out, about->slots->flown < POLICY_SOURCE_COUNT ? about->slots->idle : 0.0f);
	printer_say(out, ",");
	printer_float(out, about->pid_idle);
}

static const char *header_mix(enum nf_mix mix)
{
	return mix == NF_MIX_CENTRED ? "centred" : "attitude-first";
}

/* Names of the bits of nfFlags. */
#define FLAGS "0 pid,1-3 state,4-7 stop cause,8-11 fallback cause,12-15 refused cause"

/* --- All that are always there ----------------------------------------------------------------------------------- */
/* The first two lines mark the begin of a log, by which decoders separate logs in one file. */
#define LINES(X)                                                                                                  \
	X("Product", printer_say(out, "Blackbox flight data recorder by Nicholas Sherlock"))                      \
	X("Data version", printer_say(out, "2"))                                                                  \
	X("I interval", printer_say(out, "%u", LOG_INTRA_INTERVAL))                                               \
	X("P interval", printer_say(out, "%u", (unsigned)s->blackbox_divider))                                    \
	X("Field I name", log_frames_line(out, frames, LOG_INTRA, LOG_LINE_NAME))                                 \
	X("Field I signed", log_frames_line(out, frames, LOG_INTRA, LOG_LINE_SIGNED))                             \
	X("Field I predictor", log_frames_line(out, frames, LOG_INTRA, LOG_LINE_PREDICTOR))                       \
	X("Field I encoding", log_frames_line(out, frames, LOG_INTRA, LOG_LINE_ENCODING))                         \
	X("Field P predictor", log_frames_line(out, frames, LOG_INTER, LOG_LINE_PREDICTOR))                       \
	X("Field P encoding", log_frames_line(out, frames, LOG_INTER, LOG_LINE_ENCODING))                         \
	X("Field S name", log_slow_line(out, LOG_LINE_NAME))                                                      \
	X("Field S signed", log_slow_line(out, LOG_LINE_SIGNED))                                                  \
	X("Field S predictor", log_slow_line(out, LOG_LINE_PREDICTOR))                                            \
	X("Field S encoding", log_slow_line(out, LOG_LINE_ENCODING))                                              \
	X("Firmware type", printer_say(out, "Cleanflight"))                                                       \
	X("Firmware revision", printer_say(out, "Betaflight " NF_MSP_RELEASE " (Neuroflight) %s", about->target)) \
	X("Firmware API version", printer_say(out, TEXT(NF_MSP_API_MAJOR) "." TEXT(NF_MSP_API_MINOR) ".0"))       \
	X("Board information", printer_say(out, "%s %s", about->maker, about->target))                            \
	X("Log start datetime", printer_say(out, "0000-01-01T00:00:00.000+00:00"))                                \
	X("Craft name", printer_say(out, "%.*s", NF_SETTING_TEXT_BYTES, s->craft_name))                           \
	X("minthrottle", printer_say(out, "1000"))                                                                \
	X("maxthrottle", printer_say(out, "2000"))                                                                \
	X("gyro_scale", printer_say(out, "0x3f800000"))                                                           \
	X("motorOutput", printer_say(out, TEXT(NF_DSHOT_MIN) "," TEXT(NF_DSHOT_MAX)))                             \
	X("motor_poles", printer_say(out, "%u", (unsigned)s->motor_poles))                                        \
	X("dshot_bidir", printer_say(out, "%u", (unsigned)s->motor_telemetry))                                    \
	X("acc_1G", printer_say(out, "2048"))                                                                     \
	X("vbatref", printer_say(out, "%u", (unsigned)about->volts_cv))                                           \
	X("vbatcellvoltage",                                                                                      \
	  printer_say(out, "%u,%u,420", header_centi(s->battery_low_v), header_centi(s->battery_warn_v)))         \
	X("looptime", printer_say(out, "%u", (unsigned)(1000000u / s->gyro_rate_hz)))                             \
	X("gyro_sync_denom", printer_say(out, "1"))                                                               \
	X("pid_process_denom", printer_say(out, "%u", (unsigned)(s->gyro_rate_hz / POLICY_CONTROL_RATE_HZ)))      \
	X("rates_type", printer_say(out, s->rates_style == NF_RATES_STYLE_ACTUAL ? "3" : "0"))                    \
	X("rc_rates", header_rates(out, s, 0))                                                                    \
	X("rc_expo", header_rates(out, s, 2))                                                                     \
	X("rates", header_rates(out, s, 1))                                                                       \
	X("deadband", printer_say(out, "%u", (unsigned)s->deadband_us))                                           \
	X("yaw_deadband", printer_say(out, "%u", (unsigned)s->yaw_deadband_us))                                   \
	X("debug_mode", printer_say(out, DEBUG_CHIRP))                                                            \
	X("fields_disabled_mask", printer_say(out, "%u", (unsigned)frames->left_out))                             \
	X("nf_version", printer_say(out, NF_VERSION_TEXT))                                                        \
	X("nf_image", header_image(out, about))                                                                   \
	X("nf_policy", header_policy(out, about))                                                                 \
	X("nf_aircraft", header_aircraft(out, about))                                                             \
	X("nf_observation", header_observation(out))                                                              \
	X("nf_idle", header_idle(out, about))                                                                     \
	X("nf_mix", printer_say(out, "%s,%s", header_mix(about->slots->mix), header_mix(about->pid_mix)))         \
	X("nf_gyro_mean", printer_say(out, "%u", (unsigned)about->gyro_mean))                                     \
	X("nf_control_rate", printer_say(out, "%u", (unsigned)POLICY_CONTROL_RATE_HZ))                            \
	X("nf_gyro_rate", printer_say(out, "%u", (unsigned)s->gyro_rate_hz))                                      \
	X("nf_motor_count", printer_say(out, "%u", (unsigned)POLICY_ACTION_COUNT))                                \
	X("nf_first_step", printer_say(out, "%u", (unsigned)about->first_step))                                   \
	X("nf_flags", printer_say(out, FLAGS))

/* The ecosystem's number of the debug mode whose slots debug[0] to debug[3] are. */
#define DEBUG_CHIRP "97"

#define NAME(name, write) name,
static const char *const names[] = { LINES(NAME) };
#define LINE_COUNT (sizeof names / sizeof names[0])
#define CASE(name, write)       \
	if (number == line++) { \
		write;          \
		return;         \
	}

static void header_line(struct printer *out, unsigned number, const struct log_about *about,
			const struct log_frames *frames)
{
	const struct nf_settings *s = about->settings;
	unsigned line = 0;

	printer_say(out, "H %s:", names[number]);
	LINES(CASE)
	(void)line; /* the last row counts once more than is asked */
}

/* --- Those that there are as many of as it takes ----------------------------------------------------------------- */
/* The next setting that is not its default. Returns whether there is one. */
static bool header_setting(struct printer *out, struct log_header *header, const struct nf_settings *s)
{
	for (; header->setting < NF_SETTING_COUNT; ++header->setting) {
		const struct setting *setting = settings_info(header->setting);
		union setting_value value;

		if (settings_is_default(s, header->setting))
			continue;
		settings_get(s, header->setting, &value);
		printer_say(out, "H nf_set_%s:", setting->name);
		settings_text_print(out, setting, &value);
		++header->setting;
		return true;
	}
	return false;
}

/* Writes name and unit of each debug field. */
static bool header_debug(struct printer *out, struct log_header *header, const struct log_frames *frames)
{
	static const char *const chirp[LOG_CHIRP_FIELDS] = { "chirp phase rad 0.0002", "chirp axis 1 1",
							     "chirp frequency Hz 0.1", "chirp added deg/s 1" };
	const unsigned number = header->debug, action = number - LOG_CHIRP_FIELDS,
		       observation = action - POLICY_ACTION_COUNT;

	if (frames->left_out >> NF_LOG_GROUP_DEBUG & 1u || observation == frames->observed)
		return false;
	printer_say(out, "H nf_debug_%u:", number);
	if (number < LOG_CHIRP_FIELDS)
		printer_say(out, "%s", chirp[number]);
	else if (action < POLICY_ACTION_COUNT)
		printer_say(out, "action[%u] 1 0.001", action);
	else
		printer_say(out, "observation[%u] 1 0.01", observation);
	++header->debug;
	return true;
}

/* The firmware's state, in pieces; the first one has its size and layout. */
static bool header_state(struct printer *out, struct log_header *header, const struct log_about *about)
{
	const struct log_snapshot *snapshot = about->snapshot;

	if (!snapshot || !snapshot->taken || header->state == snapshot->state.size)
		return false;
	const size_t left = snapshot->state.size - header->state;
	const size_t count = left < STATE_LINE_BYTES ? left : STATE_LINE_BYTES;
	if (header->state_line == 0)
		printer_say(out, "H nf_state_layout:%u\nH nf_state_step:%u\nH nf_state_crc:%08x\n",
			    (unsigned)snapshot->state.layout, (unsigned)(snapshot->step - 1u),
			    (unsigned)crc32_more(0, snapshot->bytes, snapshot->state.size));
	printer_say(out, "H nf_state_%u%u%u:", header->state_line / 100 % 10, header->state_line / 10 % 10,
		    header->state_line % 10);
	printer_bytes(out, (const uint8_t *)snapshot->bytes + header->state, count);
	header->state += count;
	++header->state_line;
	return true;
}

size_t log_header_next(struct log_header *header, const struct log_about *about, const struct log_frames *frames,
		       char text[LOG_LINE_BYTES])
{
	struct printer out = printer_init(text, LOG_LINE_BYTES);

	if (header->line < LINE_COUNT)
		header_line(&out, header->line++, about, frames);
	else if (!header_setting(&out, header, about->settings) && !header_debug(&out, header, frames) &&
		 !header_state(&out, header, about))
		return 0;
	printer_say(&out, "\n");
	return (size_t)(out.at - text);
}
