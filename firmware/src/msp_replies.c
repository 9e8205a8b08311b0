#include "msp_replies.h"

#include <stddef.h>

#include "nf_contract.h"
#include "policy.h"

#define SENSOR_GYRO (1u << 5)     /* bit of the sensors in STATUS */
#define MCU_NOT_TOLD 255u         /* BOARD_INFO: the numbering of chips differs between versions */
#define CONFIGURED 2u             /* BOARD_INFO's configuration state: set up */
#define SHA256_DIGITS 64
#define TEXT_MAX 32u

/* A payload in the making; what would pass its end is left out. */
struct writer {
	uint8_t *at;
	const uint8_t *end;
};

struct source {
	const struct msp_identity *identity;
	const struct firmware_status *status;
};

static void put_u8(struct writer *w, unsigned value)
{
	if (w->at < w->end)
		*w->at++ = (uint8_t)value;
}

static void put_u16(struct writer *w, unsigned value)
{
	put_u8(w, value);
	put_u8(w, value >> 8);
}

static void put_u32(struct writer *w, uint32_t value)
{
	put_u16(w, value);
	put_u16(w, value >> 16);
}

static void put_zeros(struct writer *w, unsigned count)
{
	while (count-- > 0)
		put_u8(w, 0);
}

static void put_text(struct writer *w, const char *text, unsigned limit)
{
	for (unsigned i = 0; i < limit && text[i]; i++)
		put_u8(w, (unsigned char)text[i]);
}

static void put_counted_text(struct writer *w, const char *text)
{
	unsigned length = 0;

	while (length < TEXT_MAX && text[length])
		length++;
	put_u8(w, length);
	put_text(w, text, length);
}

static void api_version(struct writer *w, const struct source *s)
{
	(void)s;
	put_u8(w, NF_MSP_PROTOCOL_VERSION);
	put_u8(w, NF_MSP_API_MAJOR);
	put_u8(w, NF_MSP_API_MINOR);
}

static void fc_variant(struct writer *w, const struct source *s)
{
	(void)s;
	put_text(w, NF_MSP_VARIANT, 4);
}

static void fc_version(struct writer *w, const struct source *s)
{
	static const uint8_t version[NF_VERSION_COUNT] = NF_VERSION;

	(void)s;
	for (int i = 0; i < NF_VERSION_COUNT; i++)
		put_u8(w, version[i]);
}

static void board_info(struct writer *w, const struct source *s)
{
	put_text(w, s->identity->board, 4);
	put_u16(w, 0); /* hardware revision */
	put_u8(w, 0);  /* board type: a flight controller without an OSD of its own */
	put_u8(w, 0);  /* capabilities: no USB serial, no soft serial */
	put_counted_text(w, s->identity->target);
	put_counted_text(w, s->identity->target); /* board name */
	put_u8(w, 4);
	put_text(w, s->identity->maker, 4);
	put_zeros(w, 32); /* signature: none */
	put_u8(w, MCU_NOT_TOLD);
	put_u8(w, CONFIGURED);
	put_u16(w, s->status->gyro_rate_hz);
	put_u32(w, 0); /* configuration problems */
	put_u8(w, 0);  /* SPI and I2C devices that a pilot could set up */
	put_u8(w, 0);
}

/* Builds are reproducible, so an image knows no date; the policy's hash tells two of them apart. */
static void build_info(struct writer *w, const struct source *s)
{
	(void)s;
	put_text(w, "Jan 01 1970", 11);
	put_text(w, "00:00:00", 8);
	put_text(w, "0000000", 7);
}

static void name(struct writer *w, const struct source *s)
{
	(void)s;
	put_text(w, POLICY_NAME, TEXT_MAX);
}

/* The common part of STATUS and STATUS_EX. */
static void put_status(struct writer *w, const struct source *s)
{
	put_u16(w, 1000000u / POLICY_CONTROL_RATE_HZ); /* control period, us */
	put_u16(w, 0);                                 /* I2C errors */
	put_u16(w, SENSOR_GYRO);
	put_u32(w, s->status->trace.armed ? NF_MSP_MODE_ARMED : 0);
	put_u8(w, 0); /* profile */
	put_u16(w, s->status->load_percent);
}

static void put_arming(struct writer *w, const struct source *s)
{
	put_u8(w, 0); /* no flight modes beyond the first 32 */
	put_u8(w, NF_ARMING_REASON_PID_MISSING + 1);
	put_u32(w, s->status->arming_reasons);
	put_u8(w, 0);  /* no restart needed */
	put_u16(w, 0); /* core temperature: not measured */
}

static void status(struct writer *w, const struct source *s)
{
	put_status(w, s);
	put_u16(w, 1000000u / s->status->gyro_rate_hz); /* gyro period, us */
	put_arming(w, s);
}

static void status_ex(struct writer *w, const struct source *s)
{
	put_status(w, s);
	put_u8(w, 1); /* profiles */
	put_u8(w, 0); /* rate profile */
	put_arming(w, s);
}

/* Accelerometer and magnetometer are not read yet: zeros. The gyro is in whole deg/s, body axes. */
static void raw_imu(struct writer *w, const struct source *s)
{
	put_zeros(w, 6);
	for (int i = 0; i < 3; i++) {
		const float deg_s = s->status->trace.gyro[i] * 57.29578f;
		put_u16(w, (uint16_t)(int16_t)(deg_s < 0.0f ? deg_s - 0.5f : deg_s + 0.5f));
	}
	put_zeros(w, 6);
}

static void motor(struct writer *w, const struct source *s)
{
	const struct control_trace *trace = &s->status->trace;

	for (unsigned i = 0; i < NF_MOTOR_COUNT_MAX; i++) {
		const unsigned value = trace->dshot[i];
		const unsigned running = 1000u + (value - NF_DSHOT_MIN) * 1000u / NF_DSHOT_SPAN;
		put_u16(w, i >= trace->motor_count ? 0 : value == NF_DSHOT_STOP ? 1000 : running);
	}
}

/* The ecosystem's order is roll, pitch, yaw, throttle, then the switches. */
static void rc(struct writer *w, const struct source *s)
{
	const uint16_t *channels_us = s->status->channels_us;

	put_u16(w, channels_us[NF_CHANNEL_ROLL]);
	put_u16(w, channels_us[NF_CHANNEL_PITCH]);
	put_u16(w, channels_us[NF_CHANNEL_YAW]);
	put_u16(w, channels_us[NF_CHANNEL_THROTTLE]);
	for (int i = NF_CHANNEL_ARM; i < NF_CHANNEL_COUNT; i++)
		put_u16(w, channels_us[i]);
}

/* Not estimated: level. */
static void attitude(struct writer *w, const struct source *s)
{
	(void)s;
	put_zeros(w, 6);
}

/* The battery is not measured: zeros. */
static void analog(struct writer *w, const struct source *s)
{
	put_u8(w, 0);                                     /* 0.1 V */
	put_u16(w, 0);                                    /* mAh drawn */
	put_u16(w, s->status->receiver_good ? 1023u : 0); /* signal strength, full or none */
	put_u16(w, 0);                                    /* 0.01 A */
	put_u16(w, 0);                                    /* 0.01 V */
}

static void uid(struct writer *w, const struct source *s)
{
	for (int i = 0; i < 3; i++)
		put_u32(w, s->identity->unique_id[i]);
}

static unsigned hex_digit(char digit)
{
	return (unsigned)(digit <= '9' ? digit - '0' : digit - 'a' + 10);
}

static void policy_info(struct writer *w, const struct source *s)
{
	static const char sha256[] = POLICY_SHA256;
	_Static_assert(sizeof sha256 == SHA256_DIGITS + 1, "lower-case hexadecimal");

	put_u32(w, POLICY_ARCHITECTURE_HASH);
	put_u16(w, POLICY_OBSERVATION_COUNT);
	put_u16(w, POLICY_ACTION_COUNT);
	put_u32(w, POLICY_WEIGHT_COUNT);
	put_u16(w, POLICY_CONTROL_RATE_HZ);
	put_u16(w, s->status->gyro_rate_hz);
	put_u8(w, s->status->policy_good);
	put_counted_text(w, POLICY_NAME);
	for (int i = 0; i < SHA256_DIGITS; i += 2)
		put_u8(w, hex_digit(sha256[i]) << 4 | hex_digit(sha256[i + 1]));
}

static const struct command {
	enum nf_msp code;
	void (*write)(struct writer *w, const struct source *s);
} commands[] = {
	{ NF_MSP_API_VERSION, api_version },
	{ NF_MSP_FC_VARIANT, fc_variant },
	{ NF_MSP_FC_VERSION, fc_version },
	{ NF_MSP_BOARD_INFO, board_info },
	{ NF_MSP_BUILD_INFO, build_info },
	{ NF_MSP_NAME, name },
	{ NF_MSP_STATUS, status },
	{ NF_MSP_RAW_IMU, raw_imu },
	{ NF_MSP_MOTOR, motor },
	{ NF_MSP_RC, rc },
	{ NF_MSP_ATTITUDE, attitude },
	{ NF_MSP_ANALOG, analog },
	{ NF_MSP_STATUS_EX, status_ex },
	{ NF_MSP_UID, uid },
	{ NF_MSP_POLICY_INFO, policy_info },
};

int msp_reply(uint16_t command, const struct msp_identity *identity, const struct firmware_status *firmware,
	      uint8_t payload[MSP_REPLY_MAX])
{
	const struct source source = { identity, firmware };
	struct writer writer = { payload, payload + MSP_REPLY_MAX };

	for (size_t i = 0; i < sizeof commands / sizeof commands[0]; i++) {
		if (commands[i].code == command) {
			commands[i].write(&writer, &source);
			return (int)(writer.at - payload);
		}
	}
	return -1;
}
