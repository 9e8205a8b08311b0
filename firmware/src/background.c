#include "background.h"

#include "filters.h"

/* --- Boot --------------------------------------------------------------------------------------------- */
/* The settings of this boot: as stored, then changed. */
static enum nf_err load_settings(struct background *background)
{
	const struct background_config *config = &background->config;

	settings_load(&background->settings, &config->flash);
	for (size_t i = 0; i < config->change_count; i++)
		if (settings_set(&background->settings, config->changes[i].index, &config->changes[i].value) !=
		    NF_REFUSAL_NONE)
			return NF_ERR_SETTINGS;
	if (config->gyro_rate_hz > 0)
		background->settings.gyro_rate_hz = config->gyro_rate_hz;
	const unsigned conflict = settings_conflict(&background->settings);
	if (conflict == NF_SETTING_COUNT)
		return NF_OK;
	return conflict == settings_find("gyro_rate_hz") ? NF_ERR_GYRO_RATE : NF_ERR_SETTINGS;
}

/* Takes the best policy for these settings. Returns whether there is one. */
static bool choose_policy(struct background *background)
{
	const struct background_config *config = &background->config;
	const struct policy_blob_identity running = {
		.architecture_hash = POLICY_ARCHITECTURE_HASH,
		.filters_hash = filters_hash(&background->settings),
		.control_rate_hz = POLICY_CONTROL_RATE_HZ,
		.weight_count = POLICY_WEIGHT_COUNT,
		.observation_count = POLICY_OBSERVATION_COUNT,
		.action_count = POLICY_ACTION_COUNT,
	};

	/* The policy's memory is the firmware's, which starts after this. */
	return policy_slots_choose(&background->slots, &config->flash, &running, &policy_blob, sizeof policy_blob,
				   &config->firmware->control.policy, config->weights) == NF_OK;
}

static enum board_alignment alignment(const struct background *background)
{
	const uint32_t set = background->settings.gyro_alignment;

	return set == NF_GYRO_ALIGNMENT_BOARD ? background->config.alignment :
						(enum board_alignment)(set - NF_GYRO_ALIGNMENT_CW0);
}

static enum nf_err start_firmware(struct background *background)
{
	const struct background_config *config = &background->config;
	const bool good = choose_policy(background);
	const struct firmware_config firmware = {
		.gyro_rate_hz = background->settings.gyro_rate_hz,
		.alignment = alignment(background),
		.settings = &background->settings,
		.weights = config->weights,
		.policy_idle = good ? background->slots.idle : NF_IDLE_DEFAULT,
		.policy_good = good,
		.pid = config->pid,
	};

	return firmware_init(config->firmware, &firmware);
}

/* --- Tasks -------------------------------------------------------------------------------------------- */
static void run_battery(void *context)
{
	struct background *background = context;
	const struct background_io *io = &background->config.io;
	struct power_sample power;

	io->power_read(io->context, &power);
	battery_step(&background->battery, power.volts_mv, power.amps_mv, power.valid);
	firmware_forbid(background->config.firmware, NF_ARMING_REASON_BATTERY_UNKNOWN,
			battery_level(&background->battery) == BATTERY_UNKNOWN);
}

static void run_storage(void *context)
{
	struct background *background = context;

	firmware_forbid(background->config.firmware, NF_ARMING_REASON_FAULT, background->faults.pending);
}

static const struct task tasks[] = {
	{ NF_TASK_BATTERY, BATTERY_RATE_HZ, run_battery },
	{ NF_TASK_STORAGE, 10, run_storage },
};

enum nf_err background_start(struct background *background, const struct background_config *config)
{
	enum nf_err err;

	*background = (struct background){ .config = *config };
	if ((err = load_settings(background)) != NF_OK || (err = start_firmware(background)) != NF_OK)
		return err;
	fault_log_boot(&background->faults, &background->config.flash, config->fault);
	firmware_forbid(config->firmware, NF_ARMING_REASON_FAULT, background->faults.pending);
	battery_init(&background->battery, &background->settings);
	for (size_t i = 0; i < TASK_COUNT; i++)
		task_stats_init(&config->stats[i], 0);
	config->stats[NF_TASK_GYRO].rate_hz = background->settings.gyro_rate_hz - POLICY_CONTROL_RATE_HZ;
	config->stats[NF_TASK_CONTROL].rate_hz = POLICY_CONTROL_RATE_HZ;
	scheduler_init(&background->scheduler, tasks, sizeof tasks / sizeof tasks[0], config->stats,
		       background->settings.gyro_rate_hz, config->io.cycles, config->io.context);
	return NF_OK;
}

void background_step(struct background *background)
{
	scheduler_step(&background->scheduler, background->config.firmware->samples, background);
}

/* Share of the gyro's period that its longest sample took. */
static uint16_t load_percent(const struct background *background)
{
	const struct task_stats *stats = background->config.stats;
	const uint32_t gyro = stats[NF_TASK_GYRO].worst, control = stats[NF_TASK_CONTROL].worst;
	const uint32_t longest = gyro > control ? gyro : control;
	const uint32_t percent = longest / (background->config.cycles_hz / background->settings.gyro_rate_hz / 100u);

	return (uint16_t)(percent < UINT16_MAX ? percent : UINT16_MAX);
}

void background_status(const struct background *background, struct firmware_status *status)
{
	const struct battery *battery = &background->battery;

	firmware_status(background->config.firmware, status);
	status->load_percent = load_percent(background);
	status->volts = battery->volts;
	status->amps = battery->amps;
	status->drawn_mah = (float)battery_mah(battery);
	status->sag_v = battery_sag(battery);
	status->cells = (uint8_t)battery->cells;
	status->battery_level = (uint8_t)battery_level(battery);
}
