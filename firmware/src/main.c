/* Ties the core to the hardware boundary. Common to every target. */
#include "background.h"
#include "firmware.h"
#include "hal/hal.h"
#include "control/pid.h"
#include "housekeeping/scheduler.h"

/* The only mutable state of the program outside the chip directory. What the gyro's interrupt works on... */
static struct firmware firmware;
static _Alignas(8) float weights[POLICY_WEIGHT_COUNT];
static struct task_stats stats[TASK_COUNT];
/* ...and what only the background does. */
static struct hal_info info;
static struct fault_record fault;
static struct background background;
static uint32_t fed_at; /* gyro sample at which the watchdog was fed last */

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
	const bool telemetry = firmware_sample(fw, sample, dshot);
	hal_motors_write(dshot, POLICY_ACTION_COUNT, telemetry);
	if (control_step)
		hal_trace_write(firmware_trace(fw));

	const uint32_t cycles = hal_cycles() - start;
	const bool missed = control_step && hal_deadline_missed(cycles);
	if (control_step)
		firmware_deadline(fw, missed);
	task_stats_add(&stats[control_step ? NF_TASK_CONTROL : NF_TASK_GYRO], cycles, missed);
}

static void on_gyro_silent(void *context)
{
	uint16_t dshot[POLICY_ACTION_COUNT];

	firmware_gyro_silent(context, dshot);
	hal_motors_write(dshot, POLICY_ACTION_COUNT, false);
}

/* The watchdog is fed while time goes on for the core: samples come, or their silence is known. */
static void on_background(void *context)
{
	const uint32_t now = firmware_samples(context);

	background_step(&background);
	if (now != fed_at) {
		fed_at = now;
		hal_watchdog_feed();
	}
}

static size_t on_msp(void *context, const uint8_t *bytes, size_t count, uint8_t *reply, size_t capacity)
{
	(void)context;
	return background_msp(&background, bytes, count, reply, capacity);
}

static void on_msp_reset(void *context)
{
	(void)context;
	background_msp_reset(&background);
}

static uint32_t cycles(void *context)
{
	(void)context;
	return hal_cycles();
}

static void power_read(void *context, struct power_sample *power)
{
	(void)context;
	hal_power_read(power);
}

static void beeper(void *context, bool on)
{
	(void)context;
	hal_beeper(on);
}

static void led(void *context, bool on)
{
	(void)context;
	hal_led(on);
}

static void reset(void *context)
{
	(void)context;
	hal_reset();
}

static const uint8_t *at(void *context, uint32_t address)
{
	(void)context;
	return hal_flash_at(address);
}

static bool erase(void *context, unsigned sector)
{
	(void)context;
	return hal_flash_erase(sector);
}

static bool program(void *context, uint32_t address, const void *words, size_t bytes)
{
	(void)context;
	return hal_flash_program(address, words, bytes);
}

static enum nf_err boot(void)
{
	const bool faulted = hal_fault_take(&fault);
	const struct background_config config = {
		.io = { .cycles = cycles, .power_read = power_read, .beeper = beeper, .led = led, .reset = reset },
		.flash = { .at = at, .erase = erase, .program = program },
		.firmware = &firmware,
		.weights = weights,
		.stats = stats,
		.alignment = info.alignment,
		.gyro_chip = info.gyro_chip,
		.pid = &pid_gains_built_in,
		.identity = &info.identity,
		.fault = faulted ? &fault : NULL,
		.changes = info.changes,
		.change_count = info.change_count,
		.gyro_rate_hz = info.gyro_rate_hz,
		.cycles_hz = info.cycles_hz,
	};
	const enum nf_err err = background_start(&background, &config);

	/* Only now is it in the log. */
	if (faulted)
		hal_fault_clear();
	return err;
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

	/* Without a good policy it still runs, answers MSP and says why it will not arm. */
	const enum nf_err err = boot();
	return err == NF_OK ? hal_run(&handlers, &background.settings) : hal_refuse(err);
}
