#include "hal/host/reference.h"

#include <string.h>

#include "background.h"
#include "firmware.h"
#include "hal/host/board.h"
#include "hal/host/changes.h"
#include "hal/host/convert.h"
#include "hal/host/flash_model.h"
#include "hal/host/receiver_line.h"
#include "control/pid.h"

struct reference {
	struct firmware firmware;
	_Alignas(8) float weights[POLICY_WEIGHT_COUNT];
	struct task_stats stats[TASK_COUNT];
	struct background background;
	struct power_sample power;
	double control_us;
	struct setting_change changes[NF_SETTING_COUNT];
	struct receiver_line line;
	struct flash_model flash;
	_Alignas(8) uint8_t flash_bytes[NF_FLASH_BYTES];
};
_Static_assert(_Alignof(struct reference) <= 8, "callers align to 8");

size_t reference_size(void)
{
	return sizeof(struct reference);
}

/* No time passes in a library. */
static uint32_t cycles(void *context)
{
	(void)context;
	return 0;
}

static void power_read(void *context, struct power_sample *power)
{
	const struct reference *r = context;

	*power = r->power;
}

static void switch_nothing(void *context, bool on)
{
	(void)context;
	(void)on;
}

static void reset_nothing(void *context)
{
	(void)context;
}

int reference_init(void *self, unsigned gyro_hz, const char *const settings[], size_t count)
{
	struct reference *r = self;
	struct background_config config = {
		.io = { .context = r, .cycles = cycles, .power_read = power_read, .beeper = switch_nothing,
			.led = switch_nothing, .reset = reset_nothing },
		.firmware = &r->firmware,
		.weights = r->weights,
		.stats = r->stats,
		.alignment = HOST_GYRO_ALIGNMENT,
		.pid = &pid_gains_built_in,
		.identity = &host_identity,
		.changes = r->changes,
		.change_count = count,
		.gyro_rate_hz = gyro_hz,
		.cycles_hz = 1000000000u,
	};

	memset(r, 0, sizeof *r);
	if (gyro_hz == 0)
		return NF_ERR_GYRO_RATE;
	if (count > NF_SETTING_COUNT)
		return NF_ERR_SETTINGS;
	for (size_t i = 0; i < count; i++)
		if (!change_parse(settings[i], &r->changes[i]))
			return NF_ERR_SETTINGS;
	memset(r->flash_bytes, 0xFF, sizeof r->flash_bytes);
	flash_model_init(&r->flash, r->flash_bytes);
	config.flash = flash_model_interface(&r->flash);
	r->power = convert_power(HOST_FULL_VOLTS, 0.0);
	return background_start(&r->background, &config);
}

void reference_receiver(void *self, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	struct reference *r = self;

	receiver_line_put(&r->line, channels_us);
}

void reference_power(void *self, double volts, double amps, double control_us)
{
	struct reference *r = self;

	r->power = convert_power(volts, amps);
	r->control_us = control_us;
}

void reference_sample(void *self, const double rates_frd[3], const double force_frd[3], uint16_t dshot[])
{
	struct reference *r = self;
	const bool control_step = firmware_control_due(&r->firmware);
	struct imu_sample sample = { 0 };

	sample.valid = convert_rates(rates_frd, HOST_GYRO_ALIGNMENT, sample.gyro);
	convert_force(force_frd, HOST_GYRO_ALIGNMENT, sample.accel);
	if (control_step) {
		uint8_t bytes[sizeof r->line.bytes];
		firmware_receive(&r->firmware, bytes, receiver_line_take(&r->line, bytes, sizeof bytes));
	}
	firmware_sample(&r->firmware, &sample, dshot);
	if (control_step)
		firmware_deadline(&r->firmware, r->control_us > 1e6 / POLICY_CONTROL_RATE_HZ);
	background_step(&r->background);
}

void reference_silent(void *self, uint16_t dshot[])
{
	struct reference *r = self;

	firmware_gyro_silent(&r->firmware, dshot);
}

void reference_trace(const void *self, struct reference_trace *out)
{
	const struct reference *r = self;
	const struct control_trace *trace = firmware_trace(&r->firmware);

	memset(out, 0, sizeof *out);
	out->step = trace->step;
	memcpy(out->setpoint, trace->setpoint, sizeof out->setpoint);
	memcpy(out->gyro, trace->gyro, sizeof out->gyro);
	out->throttle = trace->throttle;
	out->armed = trace->armed;
	out->motors = trace->motor_count;
	memcpy(out->dshot, trace->dshot, sizeof out->dshot);
}

size_t reference_msp(void *self, const uint8_t *in, size_t n, uint8_t *out, size_t cap)
{
	struct reference *r = self;

	return background_msp(&r->background, in, n, out, cap);
}
