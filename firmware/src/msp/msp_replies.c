#include "msp/msp_request.h"

#include "common/limit.h"
#include "common/nf_math.h"
#include "housekeeping/battery.h"
#include "nf_contract.h"
#include "policy.h"
#include "storage/mode_range.h"

#define SENSOR_GYRO (1u << 5)     /* bits of the sensors in STATUS */
#define SENSOR_ACCELEROMETER (1u << 0)
#define MCU_NOT_TOLD 255u         /* BOARD_INFO: the numbering of chips differs between versions */
#define CONFIGURED 2u             /* BOARD_INFO's configuration state: set up */
#define TYPE_WITHOUT_OSD 0u       /* BOARD_INFO's board type: a flight controller, */
#define TYPE_WITH_OSD 2u          /* with an OSD chip of its own, used or not */
#define NO_POLICY "none"          /* name of the policy where none is good */
#define RSSI_FULL 1023u

static void reply_api_version(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_u8(w, NF_MSP_PROTOCOL_VERSION);
	msp_put_u8(w, NF_MSP_API_MAJOR);
	msp_put_u8(w, NF_MSP_API_MINOR);
}

/* As the setting says: the ecosystem's app speaks to no firmware of another name than its own. */
static const char *reply_variant(const struct msp_request *q)
{
	return q->settings->msp_variant == NF_MSP_VARIANT_BTFL ? NF_MSP_VARIANT_BETAFLIGHT : NF_MSP_VARIANT;
}

static void reply_fc_variant(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_text(w, reply_variant(q), 4);
}

/* The release of the ecosystem's firmware whose MSP we speak; our own version is in IDENTITY. */
static void reply_fc_version(struct msp_writer *w, const struct msp_request *q)
{
	static const uint8_t release[NF_MSP_RELEASE_NUMBERS_COUNT] = NF_MSP_RELEASE_NUMBERS;

	msp_put_bytes(w, release, sizeof release);
	msp_put_counted_text(w, NF_MSP_RELEASE, MSP_TEXT_MAX);
}

/* Header of the policy that is flown; where none is good, one of that name with zeros else. */
static struct nf_policy_blob_header reply_policy(const struct msp_request *q)
{
	struct nf_policy_blob_header header = { .aircraft = NO_POLICY };

	(void)policy_slots_header(q->services->slots, &header);
	return header;
}

static void reply_policy_name(struct msp_writer *w, const struct msp_request *q)
{
	const struct nf_policy_blob_header policy = reply_policy(q);
	const unsigned most = sizeof policy.aircraft < MSP_TEXT_MAX ? sizeof policy.aircraft : MSP_TEXT_MAX;

	msp_put_text(w, policy.aircraft, most);
}

/* Firmware, version and policy: "Neuroflight 0.1.0 nf1". */
static void reply_board_name(struct msp_writer *w, const struct msp_request *q)
{
	char text[MSP_TEXT_MAX] = { 0 };
	struct msp_writer name = { (uint8_t *)text, (uint8_t *)text + sizeof text };

	msp_put_text(&name, NF_MSP_FIRMWARE " " NF_VERSION_TEXT " ", MSP_TEXT_MAX);
	reply_policy_name(&name, q);
	msp_put_counted_text(w, text, MSP_TEXT_MAX);
}

static void reply_board_info(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_text(w, q->services->identity->board, 4);
	msp_put_u16(w, 0); /* hardware revision */
	msp_put_u8(w, q->services->identity->osd_chip ? TYPE_WITH_OSD : TYPE_WITHOUT_OSD);
	msp_put_u8(w, 0);  /* capabilities: no USB serial, no soft serial */
	msp_put_counted_text(w, q->services->identity->target, MSP_TEXT_MAX);
	reply_board_name(w, q);
	msp_put_u8(w, 4);
	msp_put_text(w, q->services->identity->maker, 4);
	msp_put_zeros(w, 32); /* signature: none */
	msp_put_u8(w, MCU_NOT_TOLD);
	msp_put_u8(w, CONFIGURED);
	msp_put_u16(w, q->status->gyro_rate_hz);
	msp_put_u32(w, 0); /* configuration problems */
	msp_put_u8(w, 0);  /* SPI and I2C devices that a pilot could set up */
	msp_put_u8(w, 0);
}

/* Builds are reproducible, so an image has no date; images differ by the policy's hash. */
static void reply_build_info(struct msp_writer *w, const struct msp_request *q)
{
	static const uint16_t options[NF_MSP_BUILD_OPTIONS_COUNT] = NF_MSP_BUILD_OPTIONS;

	msp_put_text(w, "Jan 01 1970", 11);
	msp_put_text(w, "00:00:00", 8);
	msp_put_text(w, "0000000", 7);
	for (int i = 0; i < NF_MSP_BUILD_OPTIONS_COUNT; ++i)
		msp_put_u16(w, options[i]);
	msp_put_u16(w, 0); /* no others: the ecosystem's app offers the pages of these alone */
}

/* The craft's; while it has none, the policy's. */
static void reply_name(struct msp_writer *w, const struct msp_request *q)
{
	if (q->settings->craft_name[0])
		msp_put_text(w, q->settings->craft_name, NF_SETTING_TEXT_BYTES);
	else
		reply_policy_name(w, q);
}

/* Modes that are on, ARM only while armed, whatever its switch says. */
static uint32_t reply_modes(const struct firmware_status *status)
{
	_Static_assert(MODE_BIT(ARM) == NF_MSP_MODE_ARMED, "the first");

	return (status->modes & ~MODE_BIT(ARM)) | (status->trace.armed ? MODE_BIT(ARM) : 0u);
}

/* The common part of STATUS and STATUS_EX. */
static void reply_put_status(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_u16(w, 1000000u / POLICY_CONTROL_RATE_HZ); /* control period, us */
	msp_put_u16(w, 0);                                 /* I2C errors */
	msp_put_u16(w, SENSOR_GYRO | (q->status->attitude_known ? SENSOR_ACCELEROMETER : 0u));
	msp_put_u32(w, reply_modes(q->status));
	msp_put_u8(w, 0); /* profile */
	msp_put_u16(w, q->status->load_percent);
}

/* Our reasons under the ecosystem's numbers. */
static uint32_t reply_arming_flags(const struct firmware_status *status)
{
	static const uint8_t bits[NF_ARMING_FLAGS_COUNT] = NF_ARMING_FLAGS;
	_Static_assert(NF_ARMING_FLAGS_COUNT == NF_ARMING_REASON_COUNT, "a bit for each reason");
	uint32_t flags = 0;

	for (unsigned reason = 0; reason < NF_ARMING_REASON_COUNT; ++reason)
		if (status->arming_reasons >> reason & 1u)
			flags |= 1u << bits[reason];
	if (status->state == NF_FLIGHT_FAILSAFE_HOLD || status->state == NF_FLIGHT_FAILSAFE_DROP)
		flags |= 1u << NF_ARMING_FLAG_FAILSAFE;
	if (status->arming_reasons != 0 && (status->modes & MODE_BIT(ARM)))
		flags |= 1u << NF_ARMING_FLAG_SWITCH;
	return flags;
}

static void reply_put_arming(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_u8(w, 0); /* no flight modes beyond the first 32 */
	msp_put_u8(w, NF_ARMING_FLAG_COUNT);
	msp_put_u32(w, reply_arming_flags(q->status));
	msp_put_u8(w, 0);  /* no restart needed */
	msp_put_u16(w, 0); /* core temperature: not measured */
	msp_put_u8(w, 1);  /* rate profiles */
}

static void reply_status(struct msp_writer *w, const struct msp_request *q)
{
	reply_put_status(w, q);
	msp_put_u16(w, 1000000u / q->status->gyro_rate_hz); /* gyro period, us */
	reply_put_arming(w, q);
}

static void reply_status_ex(struct msp_writer *w, const struct msp_request *q)
{
	reply_put_status(w, q);
	msp_put_u8(w, 1); /* profiles */
	msp_put_u8(w, 0); /* rate profile */
	reply_put_arming(w, q);
}

/* Body axes; there is no magnetometer. */
static void reply_raw_imu(struct msp_writer *w, const struct msp_request *q)
{
	for (int i = 0; i < 3; ++i)
		msp_put_rounded(w, q->status->accel_g[i] * NF_MSP_ACCELERATION_COUNTS);
	for (int i = 0; i < 3; ++i)
		msp_put_rounded(w, q->status->trace.gyro[i] * (NF_DEG_PER_RAD * NF_MSP_GYRO_COUNTS));
	msp_put_zeros(w, 6);
}

static void reply_motor(struct msp_writer *w, const struct msp_request *q)
{
	const struct control_trace *trace = &q->status->trace;

	for (unsigned i = 0; i < NF_MOTOR_COUNT_MAX; ++i) {
		const unsigned value = trace->dshot[i];
		const unsigned running = 1000u + (value - NF_DSHOT_MIN) * 1000u / NF_DSHOT_SPAN;
		msp_put_u16(w, i >= trace->motor_count ? 0 : value == NF_DSHOT_STOP ? 1000 : running);
	}
}

/* What extended telemetry has told of a motor, times the units that a reply has in its own; 0: nothing. */
static unsigned reply_told(const struct rotors *rotors, unsigned motor, enum nf_esc_told kind, unsigned units)
{
	return rotors->known[motor] >> kind & 1u ? rotors->told[motor][kind] * units : 0u;
}

/* Each number is read at once: a control step may fall between two of them. */
static void reply_motor_telemetry(struct msp_writer *w, const struct msp_request *q)
{
	const struct rotors *rotors = q->services->rotors;

	msp_put_u8(w, POLICY_ACTION_COUNT);
	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i) {
		const float rpm = rotors->speed[i] * (30.0f / NF_PI);
		msp_put_u32(w, (uint32_t)limit(rpm + 0.5f, 0.0f, 1e6f));
		msp_put_u16(w, rotors_errors(rotors, i));
		msp_put_u8(w, reply_told(rotors, i, NF_ESC_TEMPERATURE, 1));
		msp_put_u16(w, reply_told(rotors, i, NF_ESC_VOLTAGE, 25));
		msp_put_u16(w, reply_told(rotors, i, NF_ESC_CURRENT, 100));
		msp_put_u16(w, 0); /* charge: not told */
	}
}

/* The ecosystem's order is roll, pitch, yaw, throttle, then the switches. */
static void reply_rc(struct msp_writer *w, const struct msp_request *q)
{
	const uint16_t *channels_us = q->status->channels_us;

	msp_put_u16(w, channels_us[NF_CHANNEL_ROLL]);
	msp_put_u16(w, channels_us[NF_CHANNEL_PITCH]);
	msp_put_u16(w, channels_us[NF_CHANNEL_YAW]);
	msp_put_u16(w, channels_us[NF_CHANNEL_THROTTLE]);
	for (int i = NF_CHANNEL_AUX1; i < NF_CHANNEL_COUNT; ++i)
		msp_put_u16(w, channels_us[i]);
}

/* For those who have one byte for it. */
static unsigned reply_tenths_of_volts(float volts)
{
	return (unsigned)(limit(volts * 10.0f, 0.0f, UINT8_MAX - 1) + 0.5f);
}

/* Tenths of a degree; the heading, whole degrees, turns right from where the aircraft woke up. */
static void reply_attitude(struct msp_writer *w, const struct msp_request *q)
{
	const float *angles = q->status->attitude_deg;
	const float right = -angles[2];

	msp_put_rounded(w, angles[0] * 10.0f);
	msp_put_rounded(w, angles[1] * 10.0f);
	msp_put_rounded(w, right < 0.0f ? right + 360.0f : right);
}

static void reply_analog(struct msp_writer *w, const struct msp_request *q)
{
	const struct firmware_status *status = q->status;

	msp_put_u8(w, reply_tenths_of_volts(status->volts));
	msp_put_rounded(w, status->drawn_mah);
	msp_put_u16(w, status->receiver_quality * RSSI_FULL / 100u);
	msp_put_rounded(w, status->amps * 100.0f);
	msp_put_rounded(w, status->volts * 100.0f);
}

static void reply_battery_state(struct msp_writer *w, const struct msp_request *q)
{
	static const uint8_t states[] = {
		/* the ecosystem's: 0 good, 1 warning, 2 critical, 3 none there */
		[BATTERY_UNKNOWN] = 3,
		[BATTERY_GOOD] = 0,
		[BATTERY_WARN] = 1,
		[BATTERY_LOW] = 2,
	};
	const struct firmware_status *status = q->status;

	msp_put_u8(w, status->cells);
	msp_put_u16(w, q->settings->battery_capacity_mah);
	msp_put_u8(w, reply_tenths_of_volts(status->volts));
	msp_put_rounded(w, status->drawn_mah);
	msp_put_rounded(w, status->amps * 100.0f);
	msp_put_u8(w, states[status->battery_level <= BATTERY_LOW ? status->battery_level : BATTERY_UNKNOWN]);
	msp_put_rounded(w, status->volts * 100.0f);
}

#define METER_ID 10u /* of the only battery, as in its configuration */

static void reply_voltage_meters(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_u8(w, METER_ID);
	msp_put_u8(w, reply_tenths_of_volts(q->status->volts));
}

static void reply_current_meters(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_u8(w, METER_ID);
	msp_put_rounded(w, q->status->drawn_mah);
	msp_put_u16(w, (unsigned)(limit(q->status->amps * 1000.0f, 0.0f, UINT16_MAX) + 0.5f));
}

/* The modes, in the order of their bits in STATUS. */
static void reply_boxnames(struct msp_writer *w, const struct msp_request *q)
{
	static const char *const names[] = {
		[MODE_ARM] = "ARM", [MODE_BEEPER] = "BEEPER", [MODE_BLACKBOX] = "BLACKBOX",
		[MODE_PID] = "PID", [MODE_TRIAL] = "TRIAL",   [MODE_CHIRP] = "CHIRP",
	};
	_Static_assert(sizeof names / sizeof names[0] == MODE_COUNT, "each has a name");

	for (unsigned mode = 0; mode < MODE_COUNT; ++mode) {
		msp_put_text(w, names[mode], MSP_TEXT_MAX);
		msp_put_u8(w, ';');
	}
}

static void reply_boxids(struct msp_writer *w, const struct msp_request *q)
{
	for (unsigned mode = 0; mode < MODE_COUNT; ++mode)
		msp_put_u8(w, mode_range_mode((enum mode_index)mode));
}

static void reply_pidnames(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_text(w, "ROLL;PITCH;YAW;LEVEL;MAG;", UINT8_MAX);
}

static void reply_mcu_info(struct msp_writer *w, const struct msp_request *q)
{
	msp_put_u8(w, MCU_NOT_TOLD);
	msp_put_counted_text(w, q->services->identity->mcu, MSP_TEXT_MAX);
}

static void reply_uid(struct msp_writer *w, const struct msp_request *q)
{
	for (int i = 0; i < 3; ++i)
		msp_put_u32(w, q->services->identity->unique_id[i]);
}

/* Name and hash of the policy that is flown; where none is good, that there is none, and zeros. */
static void reply_policy_is(struct msp_writer *w, const struct msp_request *q)
{
	const struct nf_policy_blob_header header = reply_policy(q);

	msp_put_counted_text(w, header.aircraft, sizeof header.aircraft);
	msp_put_bytes(w, header.policy_sha256, sizeof header.policy_sha256);
}

static void reply_identity(struct msp_writer *w, const struct msp_request *q)
{
	static const uint8_t version[NF_VERSION_COUNT] = NF_VERSION;

	msp_put_counted_text(w, NF_MSP_FIRMWARE, MSP_TEXT_MAX);
	msp_put_bytes(w, version, sizeof version);
	msp_put_u8(w, NF_MSP_API_MAJOR);
	msp_put_u8(w, NF_MSP_API_MINOR);
	msp_put_counted_text(w, q->services->identity->target, MSP_TEXT_MAX);
	msp_put_text(w, reply_variant(q), 4);
	reply_policy_is(w, q);
}

static void reply_policy_info(struct msp_writer *w, const struct msp_request *q)
{
	const struct policy_slots *slots = q->services->slots;

	msp_put_u32(w, POLICY_ARCHITECTURE_HASH);
	msp_put_u16(w, POLICY_OBSERVATION_COUNT);
	msp_put_u16(w, POLICY_ACTION_COUNT);
	msp_put_u32(w, POLICY_WEIGHT_COUNT);
	msp_put_u16(w, POLICY_CONTROL_RATE_HZ);
	msp_put_u16(w, q->status->gyro_rate_hz);
	msp_put_u8(w, q->status->policy_good);
	reply_policy_is(w, q);
	msp_put_float(w, slots->idle);
	msp_put_u8(w, slots->flown == POLICY_SOURCE_COUNT ? NF_MSP_POLICY_NONE : slots->flown);
	msp_put_u32(w, slots->sequence);
	for (unsigned i = 0; i < POLICY_SOURCE_COUNT; ++i) /* enum nf_err, each a signed byte */
		msp_put_u8(w, (unsigned)slots->found[i]);
	msp_put_u8(w, slots->mix);
}

static void reply_safety(struct msp_writer *w, const struct msp_request *q)
{
	const struct firmware_status *status = q->status;

	msp_put_u8(w, status->state);
	msp_put_u8(w, status->stop_cause);
	msp_put_u8(w, status->fallback_cause);
	msp_put_u8(w, status->gyro_health);
	msp_put_u32(w, status->arming_reasons);
	msp_put_u8(w, status->policy_good);
	msp_put_u8(w, status->pid_built_in);
	msp_put_u8(w, status->pid_flies);
	msp_put_u8(w, status->receiver_quality);
	msp_put_rounded(w, status->temperature_deg_c * 100.0f);
	msp_put_float(w, status->idle);
	msp_put_u8(w, status->refused_cause);
	msp_put_u8(w, status->gyro_identity);
	msp_put_u8(w, status->brown_out);
	msp_put_u8(w, status->airborne);
	msp_put_u8(w, status->gyro_chip);
	msp_put_u32(w, status->motor_key);
}

static const struct command {
	enum nf_msp code;
	void (*write)(struct msp_writer *w, const struct msp_request *q);
} commands[] = {
#define REPLY(message, function) { NF_MSP_##message, reply_##function },
	NF_MSP_REPLIES(REPLY)
};

bool msp_reply(struct msp_request *q)
{
	for (size_t i = 0; i < sizeof commands / sizeof commands[0]; ++i) {
		if (commands[i].code == q->command) {
			commands[i].write(q->reply, q);
			return true;
		}
	}
	return false;
}
