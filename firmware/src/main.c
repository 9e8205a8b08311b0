/* Ties the core to the hardware boundary. Common to every target. */
#include "background.h"
#include "control/pid.h"
#include "firmware.h"
#include "housekeeping/scheduler.h"
#include "port/hal.h"
#include "runtime.h"

/* The only mutable state of the program outside the chip directory. What the gyro's interrupt works on... */
static struct firmware firmware;
static _Alignas(8) float weights[POLICY_WEIGHT_COUNT];
static struct task_stats stats[TASK_COUNT];
/* ...and what only the background does. */
static struct hal_info info;
static struct fault_record fault;
static struct background background;
static struct log_ring log_ring;

static struct runtime runtime = { .firmware = &firmware, .stats = stats, .background = &background, .log = &log_ring };

static enum nf_err boot(void)
{
	const bool faulted = hal_fault_take(&fault);
	const struct background_config config = {
		.board = info,
		.firmware = &firmware,
		.weights = weights,
		.stats = stats,
		.pid = &pid_gains_built_in,
		.fault = faulted ? &fault : NULL,
		.log = &log_ring,
	};
	const enum nf_err err = background_start(&background, &config);

	runtime.hal = info.hal;
	log_ring_init(&log_ring, background.settings.blackbox_device != NF_BLACKBOX_DEVICE_NONE);
	/* Without an entry in the log the record is all that is known of the fault: it waits for the next boot. */
	if (faulted && background.faults.logged)
		hal_fault_clear();
	return err;
}

int main(int argc, char **argv)
{
	static const struct hal_handlers handlers = {
		.context = &runtime,
		.sample = runtime_sample,
		.gyro_silent = runtime_gyro_silent,
		.background = runtime_background,
		.link = runtime_link,
		.link_reset = runtime_link_reset,
		.link_pause = runtime_link_pause,
		.link_lost = runtime_link_lost,
		.link_busy = runtime_link_busy,
		.name = runtime_name,
	};

	const int start = hal_init(argc, argv, &info);
	if (start != HAL_RUN)
		return start;

	/* Without a good policy it still runs, answers MSP and says why it will not arm. */
	const enum nf_err err = boot();
	return err == NF_OK ? hal_run(&handlers, &background.settings) : hal_refuse(err);
}
