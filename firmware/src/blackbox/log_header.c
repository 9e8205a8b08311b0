#include "blackbox/log_header.h"

#include <string.h>

#include "blackbox/log_text.h"
#include "common/crc32.h"
#include "policy.h"
#include "storage/settings_text.h"

#define STATE_LINE_BYTES ((NF_LOG_HEADER_LINE_MAX - (sizeof "H nf_state_000:\n" - 1u)) / 2u)
#define CENTI 100.0f
#define TEXT(number) TEXT_OF(number)
#define TEXT_OF(number) #number

static uint32_t header_centi(float value)
{
	return (uint32_t)(value * CENTI + 0.5f);
}

/* --- The ecosystem's lines --------------------------------------------------------------------------------------- */
/* Rates as its settings have them, whole: 0 rate, 1 max, 2 expo. */
static void header_rates(char **at, const struct nf_settings *s, unsigned which)
{
	const bool tens = s->rates_style == NF_RATES_STYLE_ACTUAL && which != 2;
	union setting_value value;

	for (unsigned axis = 0; axis < 3; ++axis) {
		settings_get(s, SETTING_AT_roll_rate + 3 * axis + which, &value);
		log_text(at, axis > 0 ? "," : "");
		log_text_whole(at, (uint32_t)(value.as_float * (tens ? 0.1f : CENTI) + 0.5f));
	}
}

static void header_cells(char **at, const struct nf_settings *s)
{
	log_text_whole(at, header_centi(s->battery_low_v));
	log_text(at, ",");
	log_text_whole(at, header_centi(s->battery_warn_v));
	log_text(at, ",420");
}

static void header_revision(char **at, const struct log_about *about)
{
	log_text(at, "Betaflight " NF_MSP_RELEASE " (Neuroflight) ");
	log_text(at, about->target);
}

/* --- Ours -------------------------------------------------------------------------------------------------------- */
/* Build and CRC of the image. */
static void header_image(char **at, const struct log_about *about)
{
	log_text_bytes(at, about->image.build, sizeof about->image.build);
	log_text(at, ",");
	log_text_hex(at, about->image.crc);
}

/* Source, sequence, architecture and SHA-256 of the policy that is flown. */
static void header_policy(char **at, const struct log_about *about)
{
	struct nf_policy_blob_header header;

	log_text_whole(at, about->slots->flown);
	if (!policy_slots_header(about->slots, &header))
		return;
	log_text(at, ",");
	log_text_whole(at, header.sequence);
	log_text(at, ",");
	log_text_hex(at, header.architecture_hash);
	log_text(at, ",");
	log_text_bytes(at, header.policy_sha256, sizeof header.policy_sha256);
}

static void header_aircraft(char **at, const struct log_about *about)
{
	struct nf_policy_blob_header header;

	if (policy_slots_header(about->slots, &header))
		for (size_t i = 0; i < sizeof header.aircraft && header.aircraft[i]; ++i)
			*(*at)++ = header.aircraft[i];
}

/* Writes each term of the observation: block, age in steps, gain of its low-pass. */
static void header_observation(char **at)
{
	for (unsigned i = 0; i < POLICY_OBSERVATION_TERM_COUNT; ++i) {
		log_text(at, i > 0 ? "," : "");
		log_text_whole(at, policy_observation_blocks[i]);
		log_text(at, "@");
		log_text_whole(at, policy_observation_ages[i]);
		log_text(at, "~");
		log_text_float(at, policy_observation_gains[i]);
	}
}

static void header_idle(char **at, const struct log_about *about)
{
	log_text_float(at, about->slots->flown < POLICY_SOURCE_COUNT ? about->slots->idle : 0.0f);
	log_text(at, ",");
	log_text_float(at, about->pid_idle);
}

static void header_mix(char **at, const struct log_about *about)
{
	static const char *const mixes[] = {
		[NF_MIX_ATTITUDE_FIRST] = "attitude-first",
		[NF_MIX_CENTRED] = "centred",
	};

	log_text(at, mixes[about->slots->mix]);
	log_text(at, ",");
	log_text(at, mixes[about->pid_mix]);
}

static void header_craft(char **at, const struct nf_settings *s)
{
	for (size_t i = 0; i < NF_SETTING_TEXT_BYTES && s->craft_name[i]; ++i)
		*(*at)++ = s->craft_name[i];
}

/* Names of the bits of nfFlags. */
#define FLAGS "0 pid,1-3 state,4-7 stop cause,8-11 fallback cause,12-15 refused cause"

/* --- All that are always there ----------------------------------------------------------------------------------- */
/* The first two lines mark the begin of a log, by which decoders separate logs in one file. */
#define LINES(X)                                                                                             \
	X("Product", log_text(at, "Blackbox flight data recorder by Nicholas Sherlock"))                     \
	X("Data version", log_text(at, "2"))                                                                 \
	X("I interval", log_text_whole(at, LOG_INTRA_INTERVAL))                                              \
	X("P interval", log_text_whole(at, s->blackbox_divider))                                             \
	X("Field I name", *at += log_frames_line(frames, LOG_INTRA, LOG_LINE_NAME, *at))                     \
	X("Field I signed", *at += log_frames_line(frames, LOG_INTRA, LOG_LINE_SIGNED, *at))                 \
	X("Field I predictor", *at += log_frames_line(frames, LOG_INTRA, LOG_LINE_PREDICTOR, *at))           \
	X("Field I encoding", *at += log_frames_line(frames, LOG_INTRA, LOG_LINE_ENCODING, *at))             \
	X("Field P predictor", *at += log_frames_line(frames, LOG_INTER, LOG_LINE_PREDICTOR, *at))           \
	X("Field P encoding", *at += log_frames_line(frames, LOG_INTER, LOG_LINE_ENCODING, *at))             \
	X("Field S name", *at += log_slow_line(LOG_LINE_NAME, *at))                                          \
	X("Field S signed", *at += log_slow_line(LOG_LINE_SIGNED, *at))                                      \
	X("Field S predictor", *at += log_slow_line(LOG_LINE_PREDICTOR, *at))                                \
	X("Field S encoding", *at += log_slow_line(LOG_LINE_ENCODING, *at))                                  \
	X("Firmware type", log_text(at, "Cleanflight"))                                                      \
	X("Firmware revision", header_revision(at, about))                                                   \
	X("Firmware API version", log_text(at, TEXT(NF_MSP_API_MAJOR) "." TEXT(NF_MSP_API_MINOR) ".0"))      \
	X("Board information", (log_text(at, about->maker), log_text(at, " "), log_text(at, about->target))) \
	X("Log start datetime", log_text(at, "0000-01-01T00:00:00.000+00:00"))                               \
	X("Craft name", header_craft(at, s))                                                                 \
	X("minthrottle", log_text(at, "1000"))                                                               \
	X("maxthrottle", log_text(at, "2000"))                                                               \
	X("gyro_scale", log_text(at, "0x3f800000"))                                                          \
	X("motorOutput", log_text(at, TEXT(NF_DSHOT_MIN) "," TEXT(NF_DSHOT_MAX)))                            \
	X("acc_1G", log_text(at, "2048"))                                                                    \
	X("vbatref", log_text_number(at, about->volts_cv))                                                   \
	X("vbatcellvoltage", header_cells(at, s))                                                            \
	X("looptime", log_text_whole(at, 1000000u / s->gyro_rate_hz))                                        \
	X("gyro_sync_denom", log_text(at, "1"))                                                              \
	X("pid_process_denom", log_text_whole(at, s->gyro_rate_hz / POLICY_CONTROL_RATE_HZ))                 \
	X("rates_type", log_text(at, s->rates_style == NF_RATES_STYLE_ACTUAL ? "3" : "0"))                   \
	X("rc_rates", header_rates(at, s, 0))                                                                \
	X("rc_expo", header_rates(at, s, 2))                                                                 \
	X("rates", header_rates(at, s, 1))                                                                   \
	X("deadband", log_text_whole(at, s->deadband_us))                                                    \
	X("yaw_deadband", log_text_whole(at, s->yaw_deadband_us))                                            \
	X("debug_mode", log_text(at, DEBUG_CHIRP))                                                           \
	X("fields_disabled_mask", log_text_whole(at, frames->left_out))                                      \
	X("nf_version", log_text(at, NF_VERSION_TEXT))                                                       \
	X("nf_image", header_image(at, about))                                                               \
	X("nf_policy", header_policy(at, about))                                                             \
	X("nf_aircraft", header_aircraft(at, about))                                                         \
	X("nf_observation", header_observation(at))                                                          \
	X("nf_idle", header_idle(at, about))                                                                 \
	X("nf_mix", header_mix(at, about))                                                                   \
	X("nf_gyro_mean", log_text_whole(at, about->gyro_mean))                                              \
	X("nf_control_rate", log_text_whole(at, POLICY_CONTROL_RATE_HZ))                                     \
	X("nf_gyro_rate", log_text_whole(at, s->gyro_rate_hz))                                               \
	X("nf_motor_count", log_text_whole(at, POLICY_ACTION_COUNT))                                         \
	X("nf_first_step", log_text_whole(at, about->first_step))                                            \
	X("nf_flags", log_text(at, FLAGS))

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

static void header_line(char **at, unsigned number, const struct log_about *about, const struct log_frames *frames)
{
	const struct nf_settings *s = about->settings;
	unsigned line = 0;

	log_text(at, "H ");
	log_text(at, names[number]);
	log_text(at, ":");
	LINES(CASE)
	(void)line; /* the last row counts once more than is asked */
}

/* --- Those that there are as many of as it takes ----------------------------------------------------------------- */
/* The next setting that is not its default. Returns whether there is one. */
static bool header_setting(char **at, struct log_header *header, const struct nf_settings *s)
{
	for (; header->setting < NF_SETTING_COUNT; ++header->setting) {
		const struct setting *setting = settings_info_beside(s, header->setting);
		union setting_value value;
		settings_get(s, header->setting, &value);
		const bool text = setting->kind == SETTING_text;
		if (text ? value.as_text[0] == '\0' : value.as_uint32_t == settings_limits(setting)->preset.as_uint32_t)
			continue;
		log_text(at, "H nf_set_");
		log_text(at, setting->name);
		log_text(at, ":");
		*at += settings_text_format(setting, &value, *at);
		++header->setting;
		return true;
	}
	return false;
}

/* Writes name and unit of each debug field. */
static bool header_debug(char **at, struct log_header *header, const struct log_frames *frames)
{
	static const char *const chirp[LOG_CHIRP_FIELDS] = { "chirp phase rad 0.0002", "chirp axis 1 1",
							     "chirp frequency Hz 0.1", "chirp added deg/s 1" };
	const unsigned number = header->debug, action = number - LOG_CHIRP_FIELDS,
		       observation = action - POLICY_ACTION_COUNT;

	if (frames->left_out >> NF_LOG_GROUP_DEBUG & 1u || observation == frames->observed)
		return false;
	log_text(at, "H nf_debug_");
	log_text_whole(at, number);
	log_text(at, ":");
	if (number < LOG_CHIRP_FIELDS) {
		log_text(at, chirp[number]);
	} else if (action < POLICY_ACTION_COUNT) {
		log_text(at, "action[");
		log_text_whole(at, action);
		log_text(at, "] 1 0.001");
	} else {
		log_text(at, "observation[");
		log_text_whole(at, observation);
		log_text(at, "] 1 0.01");
	}
	++header->debug;
	return true;
}

/* The firmware's state, in pieces; the first one has its size and layout. */
static bool header_state(char **at, struct log_header *header, const struct log_about *about)
{
	const struct log_snapshot *snapshot = about->snapshot;

	if (!snapshot || !snapshot->taken || header->state == snapshot->state.size)
		return false;
	const size_t left = snapshot->state.size - header->state;
	const size_t count = left < STATE_LINE_BYTES ? left : STATE_LINE_BYTES;
	if (header->state_line == 0) {
		log_text(at, "H nf_state_layout:");
		log_text_whole(at, snapshot->state.layout);
		log_text(at, "\nH nf_state_step:");
		log_text_whole(at, snapshot->step - 1u);
		log_text(at, "\nH nf_state_crc:");
		log_text_hex(at, crc32_more(0, snapshot->bytes, snapshot->state.size));
		log_text(at, "\n");
	}
	log_text(at, "H nf_state_");
	for (unsigned unit = 100; unit > 0; unit /= 10)
		log_text_whole(at, header->state_line / unit % 10);
	log_text(at, ":");
	log_text_bytes(at, (const uint8_t *)snapshot->bytes + header->state, count);
	header->state += count;
	++header->state_line;
	return true;
}

size_t log_header_next(struct log_header *header, const struct log_about *about, const struct log_frames *frames,
		       char text[LOG_LINE_BYTES])
{
	char *at = text;

	if (header->line < LINE_COUNT)
		header_line(&at, header->line++, about, frames);
	else if (!header_setting(&at, header, about->settings) && !header_debug(&at, header, frames) &&
		 !header_state(&at, header, about))
		return 0;
	log_text(&at, "\n");
	return (size_t)(at - text);
}
