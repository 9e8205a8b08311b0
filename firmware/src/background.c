#include "background.h"

#include <string.h>

#include "common/crc32.h"
#include "common/limit.h"
#include "common/nf_math.h"
#include "common/printer.h"
#include "policy.h"

#define ALERT_RATE_HZ 50
#define STORAGE_RATE_HZ 10
#define WEIGHTS_AT_ONCE ((size_t)POLICY_WEIGHT_COUNT / 8 + 1) /* all of them in less than a second */
#define FAULT_LOG_RENEW_MS 5000u
#define ESCS_FIRST 5u /* runs of the storage task before ESCs that answer are asked for more, */
#define ESCS_AGAIN 20u /* and until they are asked again */
#define ESCS_TIMES 5u
#define TOOK_OVER_MS 3000u /* so long beeper and LED tell nothing but that the PID took over */

/* The settings that the contract marks at_once: rates and dead bands, and the PID's factors. Each group is
 * contiguous. */
#define TUNED_RATES_BYTES (12u * sizeof(uint32_t))
#define TUNED_PID_BYTES (9u * sizeof(uint32_t))
_Static_assert(SETTING_AT_interpolation - SETTING_AT_rates_style == 12, "style, three numbers an axis, two dead bands");
_Static_assert(SETTING_AT_battery_cells - SETTING_AT_pid_roll_p == 9, "three factors an axis");

/* The settings that say how gyro and motors are built in. Each group is contiguous. */
#define GYRO_BUILT_BYTES (5u * sizeof(uint32_t))
#define MOTORS_BUILT_BYTES ((NF_MOTOR_COUNT_MAX + 1u) * sizeof(uint32_t))
_Static_assert(SETTING_AT_gyro_stuck_ms - SETTING_AT_gyro_select == 5, "the chip, its turn, the board's three");
_Static_assert(SETTING_AT_motor_check - SETTING_AT_motor1_output == NF_MOTOR_COUNT_MAX + 1, "outputs, direction");

/* The number of what a check of the motors holds for: this board, its aircraft's name, and how gyro and motors are set. */
static uint32_t background_motor_key(const struct background *background)
{
	const struct nf_settings *settings = &background->settings;
	struct nf_policy_blob_header policy = { 0 };

	(void)policy_slots_header(&background->slots, &policy);
	uint32_t crc = crc32_more(0, background->config.board.identity.unique_id, 3u * sizeof(uint32_t));
	crc = crc32_more(crc, policy.aircraft, sizeof policy.aircraft);
	crc = crc32_more(crc, &settings->gyro_select, GYRO_BUILT_BYTES);
	crc = crc32_more(crc, &settings->motor1_output, MOTORS_BUILT_BYTES);
	return (crc & NF_MOTOR_KEY_MAX) | 1u; /* 0: never checked */
}

/* Forbids arming where a check of the motors is asked for: by the policy, or as one was passed before. The pilot may do
 * without at once, or for this start alone (--set). */
static void background_judge_motors(const struct background *background)
{
	const struct nf_settings *edited = &background->edited;
	const bool asks = edited->motor_check != 0 && background->settings.motor_check != 0 &&
			  (edited->motors_checked != 0 || POLICY_MOTOR_CHECK != 0);

	firmware_forbid(background->config.firmware, NF_ARMING_REASON_MOTORS_UNCHECKED,
			asks && edited->motors_checked != background->motor_key);
}

/* Takes over the edited settings if they were edited since the last call. (Until the first edit the settings of the
 * start are flown, which `--set` may have changed.) While the motors turn or a log is written, whose header contains
 * the settings of its start, it does nothing and the next call tries again. Settings that conflict with others that
 * are flown, such as gains with slow filters, take effect at the next boot. */
static void background_tune(struct background *background)
{
	const struct nf_settings *edited = &background->edited;
	struct nf_settings *tuned = &background->tuned;

	if ((memcmp(&edited->rates_style, &tuned->rates_style, TUNED_RATES_BYTES) == 0 &&
	     memcmp(&edited->pid_roll_p, &tuned->pid_roll_p, TUNED_PID_BYTES) == 0) ||
	    blackbox_logs(&background->blackbox) || background_storing(background, true) != NF_REFUSAL_NONE)
		return;
	*tuned = background->settings;
	memcpy(&tuned->rates_style, &edited->rates_style, TUNED_RATES_BYTES);
	memcpy(&tuned->pid_roll_p, &edited->pid_roll_p, TUNED_PID_BYTES);
	if (settings_conflict(tuned) == NF_SETTING_COUNT) {
		background->settings = *tuned;
		firmware_tune_init(background->config.firmware, tuned);
		background->snapshot.taken = false;
	}
	(void)background_storing(background, false);
}

/* --- Tasks -------------------------------------------------------------------------------------------- */
static void background_run_battery(void *context)
{
	struct background *background = context;
	const struct hal *hal = background->config.board.hal;
	struct power_sample power;

	hal->power_read(hal->context, &power);
	battery_step(&background->battery, power.volts_mv, power.amps_mv, power.valid);
	const bool known = background->battery.level != BATTERY_UNKNOWN;
	firmware_forbid(background->config.firmware, NF_ARMING_REASON_BATTERY_UNKNOWN, !known);
	firmware_power(background->config.firmware, known ? background->battery.volts : 0.0f);
}

static uint32_t background_ms(const struct background *background)
{
	const uint32_t samples = firmware_samples(background->config.firmware);
	const uint32_t rate_hz = background->settings.gyro_rate_hz;

	return samples / rate_hz * 1000u +
	       samples % rate_hz * 1000u / rate_hz; /* no product is lost: 8000 times 1000 */
}

/* Returns the count of the reason that keeps the pilot from arming while the arm switch is on; 0 if there is none, or if it is
 * a fault, which has its own count. */
static unsigned background_not_arming(const struct background *background, const struct firmware_status *status)
{
	const bool asked = (status->modes & MODE_BIT(ARM)) != 0;
	const bool fault = status->state == NF_FLIGHT_FAULT || background->faults.pending;

	return asked && !fault ? alert_count(status->arming_reasons) : 0;
}

/* The first motor that is weak or whose ESC is silent; 0: there is none. On the ground silence counts only beside ESCs that tell:
 * where nothing does, they have no power. */
static unsigned background_bad_motor(const struct background *background, const struct firmware_status *status)
{
	const struct firmware *fw = background->config.firmware;
	const uint32_t all = (1u << POLICY_ACTION_COUNT) - 1u;
	const uint32_t silent = fw->rotors.on && (status->trace.armed || fw->rotors.silent != all) ? fw->rotors.silent :
												     0u;
	const uint32_t bad = silent | fw->weak_motor.weak;

	return bad ? 1u + (unsigned)__builtin_ctz(bad) : 0u;
}

/* Propellers that are on turn an aircraft that nobody holds: then a motor test ends. */
static void background_watch_test(const struct background *background, const struct firmware_status *status)
{
	struct motor_test *test = &background->config.firmware->motor_test;
	bool turns = false;

	for (int i = 0; i < 3; ++i)
		turns |= !(magnitude(status->trace.gyro[i]) < NF_MOTOR_TEST_TURN_DEG_S * NF_RAD_PER_DEG);
	if (turns && motor_test_open(test))
		(void)motor_test_ask(test, 0, true);
}

/* Returns the active alerts, one bit each. */
static uint32_t background_alerts(const struct background *background, const struct firmware_status *status,
				  uint32_t ms)
{
	const enum battery_level level = background->battery.level;
	const bool find_me = (status->modes & MODE_BIT(BEEPER)) != 0;
	const bool lost = background->heard && !status->receiver_good;
	const bool stopped = status->state == NF_FLIGHT_FAULT || background->faults.pending;
	const bool not_arming = background_not_arming(background, status) > 0;
	const bool fault = stopped || (status->gyro_health != NF_GYRO_HEALTH_GOOD && !not_arming);
	const bool took_over = background->refused && status->trace.armed &&
			       ms - background->refused_since_ms < TOOK_OVER_MS;

	return (uint32_t)not_arming << ALERT_NOT_ARMING | (uint32_t)took_over << ALERT_TOOK_OVER |
	       (uint32_t)stopped << ALERT_FAULT_TOLD | (uint32_t)background->refused << ALERT_POLICY_REFUSED |
	       (uint32_t)fault << ALERT_FAULT | (uint32_t)(status->state == NF_FLIGHT_CRASHED) << ALERT_CRASHED |
	       (uint32_t)find_me << ALERT_FIND_ME | (uint32_t)lost << ALERT_RECEIVER_LOST |
	       (uint32_t)(level == BATTERY_LOW) << ALERT_BATTERY_LOW |
	       (uint32_t)(background_bad_motor(background, status) > 0) << ALERT_MOTOR |
	       (uint32_t)(level == BATTERY_WARN) << ALERT_BATTERY_WARN |
	       (uint32_t)(status->state == NF_FLIGHT_CALIBRATING) << ALERT_CALIBRATING |
	       1u << (status->trace.armed ? ALERT_ARMED : ALERT_DISARMED);
}

static void background_run_alert(void *context)
{
	struct background *background = context;
	const struct hal *hal = background->config.board.hal;
	const struct firmware *fw = background->config.firmware;
	const uint32_t ms = background_ms(background);
	struct firmware_status status;

	firmware_status(fw, &status);
	background_watch_test(background, &status);
	background->heard |= status.receiver_good;
	if (!background->refused)
		background->refused_since_ms = ms;
	background->refused = status.refused_cause != NF_FALLBACK_NONE;
	const struct alert_counts counts = {
		.fault = status.state == NF_FLIGHT_FAULT ? status.stop_cause : background->faults.record.kind,
		.not_arming = background_not_arming(background, &status),
		.motor = background_bad_motor(background, &status),
	};
	const struct alert_state state = alert_step(&background->alert, background_alerts(background, &status, ms),
						    &counts, ms);
	hal->beeper(hal->context, state.beeper);
	hal->led(hal->context, state.led);
}

/* The pilot's sticks acknowledge what MSP's ACKNOWLEDGE does, under the same interlock. */
static void background_watch_gesture(struct background *background)
{
	struct firmware_status status;

	firmware_status(background->config.firmware, &status);
	const bool allowed = status.state == NF_FLIGHT_DISARMED && status.receiver_good &&
			     !(status.modes & MODE_BIT(ARM));
	if (!gesture_step(&background->gesture, status.channels_us, allowed, background_ms(background)) ||
	    background_storing(background, true) != NF_REFUSAL_NONE)
		return;
	(void)background_acknowledge(background); /* flash refused: the LED goes on telling the fault */
	(void)background_storing(background, false);
}

/* While flash is erased motors get no frames. By this time after the boot their controllers have long heard stop frames,
 * and are done with what they do at power-up. */
static void background_renew_fault_log(struct background *background)
{
	const uint32_t quiet = background->settings.gyro_rate_hz * FAULT_LOG_RENEW_MS / 1000u;

	if (!background->faults.crowded || firmware_samples(background->config.firmware) < quiet ||
	    background_storing(background, true) != NF_REFUSAL_NONE)
		return;
	fault_log_renew(&background->faults);
	(void)background_storing(background, false);
}

/* Bad weights are made anew from flash while nothing can arm. */
static void background_restore_weights(struct background *background)
{
	const struct background_config *config = &background->config;

	if (background->weights_lost || background_storing(background, true) != NF_REFUSAL_NONE)
		return;
	background->weights_lost = !policy_slots_restore(&background->slots, &config->firmware->control.policy,
							 config->weights);
	background->weights_bad = background->weights_lost;
	firmware_weights(config->firmware, !background->weights_bad);
	(void)background_storing(background, false);
}

/* Compares some weights with those in flash, by turns, armed or not. */
static void background_check_weights(struct background *background)
{
	const size_t first = background->weights_checked, left = (size_t)POLICY_WEIGHT_COUNT - first;
	const size_t count = left < WEIGHTS_AT_ONCE ? left : WEIGHTS_AT_ONCE;

	background->weights_checked = count == left ? 0 : first + count;
	if (!background->weights_bad &&
	    !policy_slots_intact(&background->slots, background->config.weights, first, count)) {
		background->weights_bad = true;
		firmware_weights(background->config.firmware, false);
	}
	if (background->weights_bad)
		background_restore_weights(background);
}

/* Cycles as a share of the gyro period. */
static uint32_t background_percent(const struct background *background, uint32_t cycles)
{
	return cycles / (background->config.board.cycles_hz / background->settings.gyro_rate_hz / 100u);
}

/* Forbids arming after an overload: on a board, a sample that takes longer than its period delays the following ones. */
static void background_watch_load(struct background *background)
{
	static const enum nf_task watched[] = { NF_TASK_GYRO, NF_TASK_CONTROL };

	if (!background->config.board.real_time)
		return;
	const bool flew = background->flying;
	background->flying = firmware_armed(background->config.firmware);
	background->flown |= background->flying;
	const uint32_t unflown = flew || background->flying ? 0 : background->controller_cycles;
	if (background->overloaded > 0)
		--background->overloaded;
	for (size_t i = 0; i < sizeof watched / sizeof watched[0]; ++i) {
		struct task_stats *stats = &background->config.stats[watched[i]];
		const uint32_t more = watched[i] == NF_TASK_CONTROL ? unflown : 0;
		if (background_percent(background, stats->recent + more) > 100)
			background->overloaded = NF_LOAD_CALM_MS * STORAGE_RATE_HZ / 1000u;
		stats->recent = 0;
	}
	firmware_forbid(background->config.firmware, NF_ARMING_REASON_LOAD, background->overloaded > 0);
}

static void background_judge_image(const struct background *background)
{
	struct firmware *fw = background->config.firmware;

	firmware_forbid(fw, NF_ARMING_REASON_PROBATION, image_probation_holds(&background->probation));
	firmware_forbid(fw, NF_ARMING_REASON_IMAGE_BAD, image_probation_spoilt(&background->probation));
}

/* Writes the result of the image's probation while nothing can arm; otherwise tries again at the next call. */
static void background_try_image(struct background *background)
{
	const struct firmware *fw = background->config.firmware;
	const struct image_report report = {
		.policy_good = background->slots.flown != POLICY_SOURCE_COUNT && !background->weights_lost,
		.steps = fw->status.trace.step,
		.ms = background_ms(background),
	};
	const enum image_verdict verdict = image_probation_step(&background->probation, &report);

	if (verdict != IMAGE_STAYS && !background->rebooting &&
	    background_storing(background, true) == NF_REFUSAL_NONE) {
		if (verdict == IMAGE_CONFIRM)
			(void)image_probation_confirm(&background->probation);
		else if (image_probation_reject(&background->probation))
			(void)background_reboot(background, NF_REBOOT_FIRMWARE);
		(void)background_storing(background, false);
	}
	background_judge_image(background);
}

/* ESCs tell temperature, voltage and current from when they are asked to, which they obey while their motors stand; some not as
 * soon as they answer. Nobody can arm while they are asked, so an arm switch that is on comes first, and so does the gyro's
 * calibration, which beeps of motors would disturb. */
static void background_ask_escs(struct background *background)
{
	struct firmware *fw = background->config.firmware;
	const struct rotors *rotors = &fw->rotors;
	struct firmware_status status;
	bool more = false;

	for (unsigned i = 0; i < POLICY_ACTION_COUNT; ++i)
		more |= !(rotors->silent >> i & 1u) && rotors->known[i] == 0;
	if (!more)
		background->escs_asked = 0;
	firmware_status(fw, &status);
	if (!more || status.state != NF_FLIGHT_DISARMED || (status.modes & MODE_BIT(ARM))) {
		background->escs_wait = ESCS_FIRST;
		return;
	}
	if (background->escs_asked == ESCS_TIMES || background->escs_wait-- > 0)
		return;
	background->escs_wait = ESCS_AGAIN;
	++background->escs_asked;
	(void)dshot_command_ask(&fw->dshot_command, NF_DSHOT_COMMAND_EXTENDED_TELEMETRY, NF_DSHOT_ALL_MOTORS,
				!motor_test_open(&fw->motor_test)); /* refused: the next time */
}

/* Runs the work that may write flash. An acknowledged fault no longer forbids arming. */
static void background_run_storage(void *context)
{
	struct background *background = context;

	background_watch_gesture(background);
	background_tune(background);
	background_renew_fault_log(background);
	background_check_weights(background);
	background_watch_load(background);
	background_try_image(background);
	background_ask_escs(background);
	background_judge_motors(background);
	firmware_forbid(background->config.firmware, NF_ARMING_REASON_FAULT, background->faults.pending);
}

static const struct task tasks[] = {
	{ NF_TASK_BATTERY, BATTERY_RATE_HZ, background_run_battery },
	{ NF_TASK_ALERT, ALERT_RATE_HZ, background_run_alert },
	{ NF_TASK_STORAGE, STORAGE_RATE_HZ, background_run_storage },
};

/* Forbids arming until the next boot if the board or its settings require it. */
static void background_judge_board(const struct background *background)
{
	const struct background_config *config = &background->config;

	firmware_forbid(config->firmware, NF_ARMING_REASON_CLOCK, config->board.clock_inexact);
	firmware_forbid(config->firmware, NF_ARMING_REASON_SETTINGS, background->mended);
	firmware_forbid(config->firmware, NF_ARMING_REASON_GYRO_ALIGNMENT,
			config->board.alignment_disputed &&
				background->settings.gyro_alignment == NF_GYRO_ALIGNMENT_BOARD);
}

enum nf_err background_start(struct background *background, const struct background_config *config)
{
	*background = (struct background){ .config = *config };
	const enum nf_err err = background_boot(background);
	if (err != NF_OK)
		return err;
	fault_log_boot(&background->faults, &background->config.board.hal->flash, config->fault);
	firmware_forbid(config->firmware, NF_ARMING_REASON_FAULT, background->faults.pending);
	background_judge_board(background);
	background->motor_key = background_motor_key(background);
	background_judge_motors(background);
	image_probation_init(&background->probation, &background->config.board.hal->flash, config->board.bank);
	background_judge_image(background);
	battery_init(&background->battery, &background->settings, &background->config.board.identity);
	alert_init(&background->alert, &background->settings);
	gesture_init(&background->gesture);
	background_init_blackbox(background);
	background_offer_services(background);
	for (size_t i = 0; i < TASK_COUNT; ++i)
		task_stats_init(&config->stats[i], 0);
	config->stats[NF_TASK_GYRO].rate_hz = background->settings.gyro_rate_hz - POLICY_CONTROL_RATE_HZ;
	config->stats[NF_TASK_CONTROL].rate_hz = POLICY_CONTROL_RATE_HZ;
	scheduler_init(&background->scheduler, tasks, sizeof tasks / sizeof tasks[0], config->stats,
		       background->settings.gyro_rate_hz, config->board.hal->cycles, config->board.hal->context);
	return NF_OK;
}

void background_step(struct background *background)
{
	scheduler_step(&background->scheduler, firmware_samples(background->config.firmware), background);
	background_run_blackbox(background);
}

/* The longest time of a sample as a share of the gyro period: before the first flight with what the controllers add. */
static uint16_t background_load_percent(const struct background *background)
{
	const struct task_stats *stats = background->config.stats;
	const uint32_t unflown = background->flown ? 0 : background->controller_cycles;
	const uint32_t gyro = stats[NF_TASK_GYRO].worst, control = stats[NF_TASK_CONTROL].worst + unflown;
	const uint32_t longest = gyro > control ? gyro : control;
	const uint32_t percent = background_percent(background, longest);

	return (uint16_t)(percent < UINT16_MAX ? percent : UINT16_MAX);
}

void background_name(const struct background *background, char *text, size_t capacity)
{
	struct nf_policy_blob_header policy = { .aircraft = "none" };
	struct printer p = printer_init(text, capacity);

	(void)policy_slots_header(&background->slots, &policy);
	printer_say(&p, "%s %.*s", background->config.board.identity.target, (int)sizeof policy.aircraft,
		    policy.aircraft);
	*p.at = '\0';
}

static uint8_t background_gyro_chip(const struct hal_info *board)
{
	static const uint8_t identities[NF_GYRO_IDENTITIES_COUNT] = NF_GYRO_IDENTITIES;

	return identities[board->gyro_chip] == board->gyro_identity ? (uint8_t)(board->gyro_chip + 1u) : 0u;
}

void background_status(const struct background *background, struct firmware_status *status)
{
	const struct battery *battery = &background->battery;

	firmware_status(background->config.firmware, status);
	status->load_percent = background_load_percent(background);
	status->volts = battery->volts;
	status->amps = battery->amps;
	status->drawn_mah = (float)battery->mah;
	status->sag_v = battery->rest_volts - battery->volts;
	status->cells = (uint8_t)battery->cells;
	status->battery_level = (uint8_t)battery->level;
	status->motor_key = background->motor_key;
	status->gyro_identity = background->config.board.gyro_identity;
	status->gyro_chip = background_gyro_chip(&background->config.board);
	status->brown_out = background->config.board.brown_out;
}

size_t background_link(struct background *background, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply,
		       size_t capacity)
{
	const struct hal *hal = background->config.board.hal;
	const uint32_t start = hal->cycles(hal->context);
	struct firmware_status status;

	if (count == 0 && !msp_port_speaks(&background->ports[port], background->config.firmware->status.trace.step))
		return 0;
	background_status(background, &status);
	const size_t written = msp_port_serve(&background->ports[port], &status, bytes, count, reply, capacity);
	background_tune(background);
	task_stats_add(&background->config.stats[NF_TASK_MSP], hal->cycles(hal->context) - start, false);
	return written;
}
