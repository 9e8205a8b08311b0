/* Actions that MSP and the command line may request; each has one interlock, whoever requests it. */
#include "background.h"

#define FRACTION_PER_US 0.001f
_Static_assert(NF_DSHOT_ALL_MOTORS == UINT8_MAX, "as MSP says it");
_Static_assert(NF_CHANNEL_MAX_US - NF_CHANNEL_MIN_US == 1000, "FRACTION_PER_US says otherwise");

/* Arming is forbidden first, then the motors are checked to be stopped. */
enum nf_refusal background_storing(void *context, bool busy)
{
	struct background *background = context;
	struct firmware *fw = background->config.firmware;

	firmware_forbid(fw, NF_ARMING_REASON_STORING, busy || background->rebooting);
	if (!busy || firmware_stopped(fw))
		return NF_REFUSAL_NONE;
	firmware_forbid(fw, NF_ARMING_REASON_STORING, background->rebooting);
	return NF_REFUSAL_ARMED;
}

static enum nf_refusal background_test_motors(void *context, struct msp_peer *peer, uint32_t magic)
{
	struct background *background = context;
	struct firmware *fw = background->config.firmware;
	const bool may = fw->status.state == NF_FLIGHT_DISARMED && !background->rebooting;
	const enum nf_refusal refusal = motor_test_ask(&fw->motor_test, magic, may);

	if (peer)
		peer->opened = refusal == NF_REFUSAL_NONE && magic == NF_MOTOR_TEST_MAGIC ? fw->motor_test.wish : 0;
	return refusal;
}

/* Is the test that the peer opened by saying that it tests motors the one that is open? */
static bool background_owns_test(const struct background *background, const struct msp_peer *peer)
{
	return peer->test != 0 && peer->test == background->config.firmware->motor_test.wish;
}

static enum nf_refusal background_arming(void *context, struct msp_peer *peer, bool disabled, bool test)
{
	struct background *background = context;
	struct firmware *fw = background->config.firmware;
	bool locked = false;

	if (test) {
		const enum nf_refusal refusal = background_test_motors(context, NULL, NF_MOTOR_TEST_MAGIC);
		if (refusal != NF_REFUSAL_NONE)
			return refusal;
		if (disabled)
			fw->motor_test.most = NF_MOTOR_WIZARD_MAX;
	} else if (background_owns_test(background, peer) ||
		   (peer->opened != 0 && peer->opened == fw->motor_test.wish)) {
		(void)background_test_motors(context, peer, 0);
	}
	peer->test = test ? fw->motor_test.wish : 0;
	peer->locks = disabled;
	for (unsigned port = 0; port < NF_MSP_PORT_COUNT; ++port)
		locked |= background->ports[port].peer.locks;
	firmware_forbid(fw, NF_ARMING_REASON_MSP, locked);
	return NF_REFUSAL_NONE;
}

static void background_heard(void *context, const struct msp_peer *peer)
{
	struct background *background = context;

	if (background_owns_test(background, peer))
		motor_test_keep(&background->config.firmware->motor_test);
}

static enum nf_refusal background_calibrate(void *context)
{
	struct background *background = context;
	struct firmware *fw = background->config.firmware;

	if (!firmware_stopped(fw) || fw->status.state != NF_FLIGHT_DISARMED)
		return NF_REFUSAL_ARMED;
	firmware_calibrate(fw);
	return NF_REFUSAL_NONE;
}

static enum nf_refusal background_channels(void *context, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	struct background *background = context;

	return firmware_post(background->config.firmware, channels_us);
}

static enum nf_refusal background_turn_motors(void *context, const uint16_t values_us[], size_t count)
{
	struct background *background = context;
	float fractions[NF_MOTOR_COUNT_MAX];

	if (count > NF_MOTOR_COUNT_MAX)
		return NF_REFUSAL_INDEX;
	for (size_t i = 0; i < count; ++i)
		fractions[i] = (float)(values_us[i] - NF_CHANNEL_MIN_US) * FRACTION_PER_US;
	return motor_test_give(&background->config.firmware->motor_test, fractions, count);
}

static enum nf_refusal background_command_motors(void *context, unsigned motor, unsigned command)
{
	struct background *background = context;
	struct firmware *fw = background->config.firmware;

	if ((command & 0xFFu) == NF_DSHOT_COMMAND_EXTENDED_TELEMETRY)
		return NF_REFUSAL_PAYLOAD; /* ours to send, to ESCs that answer */
	return dshot_command_ask(&fw->dshot_command, command, motor,
				 !fw->status.trace.armed && !motor_test_open(&fw->motor_test));
}

enum nf_refusal background_acknowledge(void *context)
{
	struct background *background = context;
	const enum nf_refusal refusal = fault_log_acknowledge_all(&background->faults);

	if (refusal == NF_REFUSAL_NONE)
		firmware_acknowledge(background->config.firmware);
	return refusal;
}

enum nf_refusal background_reboot(void *context, enum nf_reboot kind)
{
	struct background *background = context;
	const struct hal *hal = background->config.board.hal;

	/* A start that shows the card proves nothing of the image, but counts. */
	if (kind == NF_REBOOT_CARD && image_probation_holds(&background->probation))
		return NF_REFUSAL_ORDER;
	const enum nf_refusal refusal = background_storing(context, true);

	if (refusal != NF_REFUSAL_NONE)
		return refusal;
	if (!hal->reset(hal->context, kind)) {
		(void)background_storing(context, false);
		return NF_REFUSAL_ABSENT;
	}
	background->rebooting = true; /* nothing arms while the reply is on its way */
	return NF_REFUSAL_NONE;
}

static void background_record(void *context, struct control_record *record)
{
	struct background *background = context;
	const struct background_config *config = &background->config;

	firmware_record(config->firmware, &config->stats[NF_TASK_CONTROL].last, record);
}

static uint32_t background_motor_restarts(void *context)
{
	const struct background *background = context;
	const struct hal *hal = background->config.board.hal;

	return hal->motor_restarts(hal->context);
}

static uint32_t background_samples(void *context)
{
	const struct background *background = context;

	return firmware_samples(background->config.firmware);
}

/* A command line opens or ends. Arming is forbidden first, then looked at: what comes between finds it forbidden. */
static enum nf_refusal background_session(void *context, bool open)
{
	struct background *background = context;
	struct firmware *fw = background->config.firmware;

	if (open)
		firmware_forbid(fw, NF_ARMING_REASON_CLI, true);
	const bool refused = open && firmware_armed(fw);
	if (open && !refused)
		++background->sessions;
	else if (!open)
		--background->sessions;
	firmware_forbid(fw, NF_ARMING_REASON_CLI, background->sessions > 0);
	return refused ? NF_REFUSAL_ARMED : NF_REFUSAL_NONE;
}

void background_offer_services(struct background *background)
{
	const struct background_config *config = &background->config;

	image_update_init(&background->image, &config->board.hal->flash, config->board.bank,
			  config->board.identity.target);
	background->services = (struct services){
		.identity = &config->board.identity,
		.flash = &config->board.hal->flash,
		.settings = &background->edited,
		.pid = config->pid,
		.slots = &background->slots,
		.image = &background->image,
		.faults = &background->faults,
		.blackbox = &background->blackbox,
		.rotors = &config->firmware->rotors,
		.tasks = config->stats,
		.cycles_hz = config->board.cycles_hz,
		.context = background,
		.samples = background_samples,
		.motor_restarts = background_motor_restarts,
		.record = background_record,
		.session = background_session,
		.storing = background_storing,
		.channels = background_channels,
		.arming = background_arming,
		.heard = background_heard,
		.motor_test = background_test_motors,
		.motors = background_turn_motors,
		.dshot_command = background_command_motors,
		.calibrate = background_calibrate,
		.acknowledge = background_acknowledge,
		.reboot = background_reboot,
	};
	for (unsigned port = 0; port < NF_MSP_PORT_COUNT; ++port)
		msp_port_init(&background->ports[port], &background->services);
	background->ports[NF_MSP_PORT_USB].letter = true;
}
