/* Connects the blackbox with the firmware: its configuration at boot, its inputs each round. */
#include "background.h"
#include "firmware_layout.h"

static const uint16_t held[] = FIRMWARE_HELD;

static uint32_t background_layout(void)
{
	return FIRMWARE_LAYOUT;
}

void background_init_blackbox(struct background *background)
{
	const struct background_config *config = &background->config;
	const struct firmware *fw = config->firmware;
	const struct hal *hal = config->board.hal;
	const struct nf_image_header image = image_bank_header(&hal->flash, config->board.bank);
	const struct blackbox_config blackbox = {
		.device = hal->log(hal->context, (enum nf_log_device)background->settings.blackbox_device),
		.ring = config->log,
		.gyro = &fw->gyro,
		.about = {
			.settings = &background->settings,
			.slots = &background->slots,
			.maker = config->board.identity.maker,
			.target = config->board.identity.target,
			.pid_idle = config->pid->idle,
			.pid_mix = config->pid->mix,
			.gyro_mean = fw->mean.count,
			.image = image_bank_fits(&image, config->board.bank, config->board.identity.target) ?
					 image :
					 (struct nf_image_header){ 0 },
			.snapshot = &background->snapshot,
		},
		.snapshot = &background->snapshot,
	};

	background->snapshot = (struct log_snapshot){
		.state = {
			.bytes = fw,
			.size = sizeof *fw,
			.layout = background_layout(),
			.held = held,
			.held_count = sizeof held / sizeof held[0],
			.samples = &fw->samples,
			.window = &fw->window,
			.control_steps = &fw->control_steps,
		},
		.bytes = &background->kept,
	};
	blackbox_init(&background->blackbox, &blackbox);
}

void background_run_blackbox(struct background *background)
{
	const struct firmware *fw = background->config.firmware;
	const struct blackbox_view view = {
		.armed = firmware_armed(fw),
		.modes = fw->status.modes,
		.step = fw->status.trace.step,
		.samples = firmware_samples(fw),
		.state = fw->status.state,
		.stop_cause = fw->status.stop_cause,
		.volts = background->battery.volts,
		.amps = background->battery.amps,
	};

	blackbox_step(&background->blackbox, &view);
}
