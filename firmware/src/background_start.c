/* The boot: settings, policy, firmware. */
#include <string.h>

#include "background.h"
#include "sensing/filters.h"
#include "storage/settings_store.h"

#define REHEARSALS 8u /* of each controller; the first one fills the caches and counts for nothing */

/* Another style of rates sets all of them: it goes before the rates, in whatever order the changes came. */
static bool background_change_settings(struct nf_settings *settings, const struct background_config *config)
{
	const unsigned style = settings_find("rates_style");

	for (unsigned pass = 0; pass < 2; ++pass)
		for (size_t i = 0; i < config->board.change_count; ++i) {
			const struct setting_change *change = &config->board.changes[i];
			const bool due = (change->index == style) == (pass == 0);
			if (due && settings_set(settings, change->index, &change->value) != NF_REFUSAL_NONE)
				return false;
		}
	return true;
}

static enum nf_err background_load_settings(struct background *background)
{
	const struct background_config *config = &background->config;

	background->mended = settings_load(&background->edited, &config->board.hal->flash) == SETTINGS_MENDED;
	background->settings = background->tuned = background->edited;
	if (!background_change_settings(&background->settings, config))
		return NF_ERR_SETTINGS;
	if (config->board.gyro_rate_hz > 0)
		background->settings.gyro_rate_hz = config->board.gyro_rate_hz;
	const unsigned conflict = settings_conflict(&background->settings);
	if (conflict == NF_SETTING_COUNT)
		return NF_OK;
	return conflict == settings_find("gyro_rate_hz") ? NF_ERR_GYRO_RATE : NF_ERR_SETTINGS;
}

/* Takes the best policy for these settings. Returns whether there is one. */
static bool background_choose_policy(struct background *background)
{
	const struct background_config *config = &background->config;
	const struct nf_image_header image = image_bank_header(&config->board.hal->flash, config->board.bank);
	struct policy_blob_identity running = {
		.architecture_hash = POLICY_ARCHITECTURE_HASH,
		.filters_hash = filters_hash(&background->settings),
		.control_rate_hz = POLICY_CONTROL_RATE_HZ,
		.weight_count = POLICY_WEIGHT_COUNT,
		.observation_count = POLICY_OBSERVATION_COUNT,
		.action_count = POLICY_ACTION_COUNT,
	};

	if (image_bank_fits(&image, config->board.bank, image.board))
		memcpy(running.build, image.build, sizeof running.build);
	/* The policy's state is the firmware's, which is initialised after this. */
	return policy_slots_choose(&background->slots, &config->board.hal->flash, &running, config->board.bank,
				   &config->firmware->control.policy, config->weights) == NF_OK;
}

static enum board_alignment background_alignment(const struct background *background)
{
	const uint32_t set = background->settings.gyro_alignment;

	return set == NF_GYRO_ALIGNMENT_BOARD ? background->config.board.alignment :
						(enum board_alignment)(set - NF_GYRO_ALIGNMENT_CW0);
}

/* Measures how long a controller takes, because none runs before arming. */
static void background_rehearse(struct background *background)
{
	const struct hal *hal = background->config.board.hal;

	for (unsigned pid = 0; pid < 2; ++pid)
		for (unsigned i = 0; i < REHEARSALS; ++i) {
			hal->watchdog_feed(hal->context);
			const uint32_t start = hal->cycles(hal->context);
			firmware_rehearse_init(background->config.firmware, pid != 0);
			const uint32_t took = hal->cycles(hal->context) - start;
			if (i > 0 && took > background->controller_cycles)
				background->controller_cycles = took;
		}
}

static enum nf_err background_start_firmware(struct background *background)
{
	const struct background_config *config = &background->config;
	const bool good = background_choose_policy(background);
	struct nf_policy_blob_header policy;
	const bool told = policy_slots_header(&background->slots, &policy);
	const struct firmware_config firmware = {
		.gyro_rate_hz = background->settings.gyro_rate_hz,
		.alignment = background_alignment(background),
		.turn_deg = config->board.turn_deg,
		.gyro_chip = config->board.gyro_chip,
		.settings = &background->settings,
		.weights = config->weights,
		.policy = told ? &policy : NULL,
		.policy_good = good,
		.pid = config->pid,
	};

	const enum nf_err err = firmware_init(config->firmware, &firmware);
	if (err != NF_OK || !config->board.real_time)
		return err;
	background_rehearse(background);
	return firmware_init(config->firmware, &firmware); /* of the rehearsals nothing is left */
}

enum nf_err background_boot(struct background *background)
{
	const enum nf_err err = background_load_settings(background);

	return err == NF_OK ? background_start_firmware(background) : err;
}
