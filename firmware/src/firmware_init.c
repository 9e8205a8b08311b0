/* Starts the firmware: every part of it, by the settings. */
#include <string.h>

#include "common/nf_math.h"
#include "firmware.h"
#include "storage/settings.h"

_Static_assert(POLICY_ACTION_COUNT <= NF_MOTOR_COUNT_MAX, "too many motors");
_Static_assert(POLICY_OBSERVATION_COUNT <= NF_OBSERVATION_COUNT_MAX, "too many observations");
_Static_assert(POLICY_WEIGHT_COUNT <= NF_POLICY_WEIGHT_COUNT_MAX, "too many weights for DTCM");

static enum nf_err firmware_check_rates(unsigned gyro_rate_hz)
{
	static const unsigned known[] = NF_GYRO_RATES_HZ;

	for (size_t i = 0; i < sizeof known / sizeof known[0]; ++i)
		if (known[i] == gyro_rate_hz && gyro_rate_hz % POLICY_CONTROL_RATE_HZ == 0)
			return NF_OK;
	return NF_ERR_GYRO_RATE;
}

/* The output that each motor's ESC is wired to; the settings' rules make them a permutation. */
static void firmware_outputs_init(struct firmware *fw, const struct nf_settings *settings)
{
	for (size_t i = 0; i < POLICY_ACTION_COUNT; ++i) {
		fw->outputs[i] = (uint8_t)(settings_whole(settings, SETTING_AT_motor1_output + (unsigned)i) - 1u);
		fw->rewired |= fw->outputs[i] != i;
	}
}

enum nf_err firmware_init(struct firmware *fw, const struct firmware_config *config)
{
	const struct nf_settings *settings = config->settings;
	const struct control_config control = {
		.settings = settings,
		.weights = config->weights,
		.policy = config->policy,
		.policy_good = config->policy_good,
		.pid = config->pid,
	};
	enum nf_err err = firmware_check_rates(config->gyro_rate_hz);
	if (err != NF_OK)
		return err;

	memset(fw, 0, sizeof *fw);
	fw->gyro_rate_hz = config->gyro_rate_hz;
	fw->gyro_chip = config->gyro_chip;
	fw->control_divider = config->gyro_rate_hz / POLICY_CONTROL_RATE_HZ;
	fw->grace_left = config->gyro_rate_hz * settings->arming_delay_ms / 1000u;
	fw->level_cosine = settings->level_limit_deg > 0.0f ? nf_cos_turns(settings->level_limit_deg / 360.0f) :
							      FIRMWARE_ANY_TILT;
	fw->failsafe_throttle = settings->failsafe_throttle;
	fw->doubts = settings->plausibility_detection != 0;
	fw->trial = settings->policy_trial != 0;
	fw->forbidden = SAFETY_REASON(BATTERY_UNKNOWN);
	fw->voltage_gain = 1.0f;
	fw->edges.forbidden = fw->forbidden;
	fw->status.gyro_rate_hz = (uint16_t)config->gyro_rate_hz;
	fw->status.trace.motor_count = POLICY_ACTION_COUNT;
	if ((err = gyro_init(&fw->gyro, config->gyro_rate_hz, config->alignment, settings->gyro_stuck_ms)) != NF_OK)
		return err;
	if (config->turn_deg != NULL)
		gyro_board_init(&fw->gyro, config->turn_deg[0], config->turn_deg[1], config->turn_deg[2]);
	gyro_board_init(&fw->gyro, settings->board_roll_deg, settings->board_pitch_deg, settings->board_yaw_deg);
	if ((err = control_init(&fw->control, &control)) != NF_OK)
		return err;
	rpm_filter_init(&fw->rpm, settings, config->gyro_rate_hz);
	filters_init(&fw->filters, settings, config->gyro_rate_hz);
	gyro_mean_init(&fw->mean, filters_take_mean(settings) ? fw->control_divider : 0);
	rotors_init(&fw->rotors, settings, POLICY_CONTROL_RATE_HZ);
	attitude_init(&fw->attitude, POLICY_CONTROL_RATE_HZ);
	receiver_init(&fw->receiver, settings, config->gyro_rate_hz);
	rates_init(&fw->rates, settings);
	chirp_init(&fw->chirp, settings, POLICY_CONTROL_RATE_HZ);
	safety_init(&fw->safety, settings, POLICY_CONTROL_RATE_HZ);
	takeoff_init(&fw->takeoff, settings, POLICY_CONTROL_RATE_HZ);
	turning_init(&fw->turning, POLICY_CONTROL_RATE_HZ);
	plausibility_init(&fw->plausibility, POLICY_CONTROL_RATE_HZ);
	weak_motor_init(&fw->weak_motor, POLICY_CONTROL_RATE_HZ);
	crash_init(&fw->crash, settings, POLICY_CONTROL_RATE_HZ);
	motor_test_init(&fw->motor_test, POLICY_CONTROL_RATE_HZ, POLICY_ACTION_COUNT);
	firmware_outputs_init(fw, settings);
	dshot_command_init(&fw->dshot_command, config->gyro_rate_hz, POLICY_ACTION_COUNT, fw->outputs);
	firmware_report(fw); /* a board whose gyro never speaks must still say why it does not arm */
	return NF_OK;
}
