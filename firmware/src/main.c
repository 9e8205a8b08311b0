/* Ties the core to the hardware boundary. Common to every target. */
#include "firmware.h"
#include "hal/hal.h"
#include "msp.h"
#include "settings.h"

/* The only mutable state of the program outside the chip directory. */
static struct hal_info info;
static struct nf_settings settings;
static struct firmware_config config;
static struct firmware firmware;
static struct msp msp;
static volatile uint32_t longest_cycles; /* of all samples so far */

static void on_sample(void *context, const struct imu_sample *sample)
{
	const uint32_t start = hal_cycles();
	struct firmware *fw = context;
	const bool control_step = firmware_control_due(fw);
	uint16_t dshot[POLICY_ACTION_COUNT];

	if (control_step) {
		uint8_t bytes[HAL_RECEIVER_BYTES];
		firmware_receive(fw, bytes, hal_receiver_read(bytes, sizeof bytes));
	}
	firmware_sample(fw, sample, dshot);
	hal_motors_write(dshot, POLICY_ACTION_COUNT, false);
	if (control_step)
		hal_trace_write(firmware_trace(fw));

	const uint32_t cycles = hal_cycles() - start;
	if (cycles > longest_cycles)
		longest_cycles = cycles;
}

static void on_gyro_silent(void *context)
{
	(void)context;
}

static void on_background(void *context)
{
	(void)context;
	hal_watchdog_feed();
}

static size_t on_msp(void *context, const uint8_t *bytes, size_t count, uint8_t *reply, size_t capacity)
{
	struct firmware_status status;

	firmware_status(context, &status);
	const uint32_t percent = longest_cycles / (info.cycles_hz / config.gyro_rate_hz / 100u);
	status.load_percent = (uint16_t)(percent < UINT16_MAX ? percent : UINT16_MAX);
	return msp_serve(&msp, &status, bytes, count, reply, capacity);
}

static void on_msp_reset(void *context)
{
	(void)context;
	msp_reset(&msp);
}

int main(int argc, char **argv)
{
	static const struct hal_handlers handlers = {
		.context = &firmware,
		.sample = on_sample,
		.gyro_silent = on_gyro_silent,
		.background = on_background,
		.msp = on_msp,
		.msp_reset = on_msp_reset,
	};

	const int start = hal_init(argc, argv, &info);
	if (start != HAL_RUN)
		return start;

	msp_init(&msp, &info.identity);
	settings_default(&settings);
	config = (struct firmware_config){
		.gyro_rate_hz = info.gyro_rate_hz ? info.gyro_rate_hz : settings.gyro_rate_hz,
		.alignment = settings.gyro_alignment == NF_GYRO_ALIGNMENT_BOARD ?
				     info.alignment :
				     (enum board_alignment)(settings.gyro_alignment - NF_GYRO_ALIGNMENT_CW0),
		.settings = &settings,
	};
	settings.gyro_rate_hz = config.gyro_rate_hz;
	/* A policy that fails its self-test still answers MSP and says why it will not arm. */
	const enum nf_err err = firmware_init(&firmware, &config);
	if (err != NF_OK && err != NF_ERR_POLICY)
		return hal_refuse(err);
	return hal_run(&handlers, &settings);
}
