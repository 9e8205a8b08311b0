#include "hal/host/reference.h"

#include <string.h>

#include "firmware.h"
#include "hal/host/board.h"
#include "hal/host/convert.h"
#include "hal/host/receiver_line.h"
#include "msp.h"
#include "settings.h"

struct reference {
	struct firmware firmware;
	struct msp msp;
	enum board_alignment alignment;
	struct nf_settings settings;
	struct imu_sample sample; /* the last one, its rates repeated where one is NaN */
	struct receiver_line line;
};
_Static_assert(_Alignof(struct reference) <= 8, "callers align to 8");

size_t reference_size(void)
{
	return sizeof(struct reference);
}

int reference_init(void *self, unsigned gyro_hz)
{
	struct reference *r = self;
	const struct firmware_config config = {
		.gyro_rate_hz = gyro_hz,
		.alignment = HOST_GYRO_ALIGNMENT,
		.settings = &r->settings,
	};

	memset(r, 0, sizeof *r);
	settings_default(&r->settings);
	r->alignment = config.alignment;
	msp_init(&r->msp, &host_identity);
	return firmware_init(&r->firmware, &config);
}

void reference_receiver(void *self, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	struct reference *r = self;

	receiver_line_put(&r->line, channels_us);
}

void reference_sample(void *self, const double rates_frd[3], uint16_t dshot[])
{
	struct reference *r = self;

	convert_rates(rates_frd, r->alignment, r->sample.gyro);
	r->sample.valid = true;
	if (firmware_control_due(&r->firmware)) {
		uint8_t bytes[sizeof r->line.bytes];
		firmware_receive(&r->firmware, bytes, receiver_line_take(&r->line, bytes, sizeof bytes));
	}
	firmware_sample(&r->firmware, &r->sample, dshot);
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
	struct firmware_status status;

	firmware_status(&r->firmware, &status);
	return msp_serve(&r->msp, &status, in, n, out, cap);
}
