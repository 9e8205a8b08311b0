#include "firmware.h"

#include <string.h>

#include "dshot.h"

#define REASON_IF(condition, name) ((condition) ? 1u << NF_ARMING_REASON_##name : 0u)

_Static_assert(POLICY_ACTION_COUNT <= NF_MOTOR_COUNT_MAX, "too many motors");
_Static_assert(POLICY_OBSERVATION_COUNT <= NF_OBSERVATION_COUNT_MAX, "too many observations");
_Static_assert(POLICY_WEIGHT_COUNT <= NF_POLICY_WEIGHT_COUNT_MAX, "too many weights for DTCM");

/* Keeps the compiler from moving memory accesses across; the interrupt runs on the same core. */
static inline void fence(void)
{
	__atomic_signal_fence(__ATOMIC_SEQ_CST);
}

static enum nf_err check_rates(unsigned gyro_rate_hz)
{
	static const unsigned known[] = NF_GYRO_RATES_HZ;

	for (size_t i = 0; i < sizeof known / sizeof known[0]; i++)
		if (known[i] == gyro_rate_hz && gyro_rate_hz % POLICY_CONTROL_RATE_HZ == 0)
			return NF_OK;
	return NF_ERR_GYRO_RATE;
}

/* Replays the vectors that came with the policy; one wrong bit in weights, compiler or FPU shows. */
static bool selftest(struct policy *policy, const float *weights)
{
	float action[POLICY_ACTION_COUNT];
	bool same = true;

	for (int i = 0; i < POLICY_SELFTEST_COUNT; i++) {
		if (i % POLICY_SELFTEST_STEPS == 0)
			policy_init(policy, weights);
		policy_step(policy, policy_selftest_observation[i], action);
		same &= memcmp(action, policy_selftest_action[i], sizeof action) == 0;
	}
	return same;
}

/* All that the controller remembers goes: nothing from before reaches the first armed step. */
static void reset_controller(struct firmware *fw)
{
	observation_reset(&fw->observation);
	policy_init(&fw->policy, fw->weights);
	for (int i = 0; i < POLICY_ACTION_COUNT; i++)
		fw->action[i] = 0.0f;
}

/* What forbids arming now, apart from the switch. */
static uint32_t reasons(const struct firmware *fw, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	return REASON_IF(fw->grace_left > 0, BOOT_GRACE) |
	       REASON_IF(!fw->gyro.calibrated, GYRO_NOT_CALIBRATED) |
	       REASON_IF(receiver_link(&fw->receiver) == RECEIVER_LOST, RECEIVER_LOST) |
	       REASON_IF(channels_us[NF_CHANNEL_THROTTLE] > NF_THROTTLE_LOW_US, THROTTLE_HIGH) |
	       REASON_IF(!fw->policy_good, POLICY_BAD);
}

/* Fills in what MSP tells beside the trace. */
static void report(struct firmware *fw)
{
	struct firmware_status *status = &fw->status;

	receiver_channels(&fw->receiver, status->channels_us);
	status->arming_reasons = arming_reasons(&fw->arming, reasons(fw, status->channels_us));
	status->receiver_good = receiver_link(&fw->receiver) == RECEIVER_GOOD;
	status->policy_good = fw->policy_good;
}

enum nf_err firmware_init(struct firmware *fw, const struct firmware_config *config)
{
	static const struct observation_terms terms = {
		.blocks = policy_observation_blocks,
		.ages = policy_observation_ages,
		.gains = policy_observation_gains,
		.count = POLICY_OBSERVATION_TERM_COUNT,
	};
	enum nf_err err = check_rates(config->gyro_rate_hz);
	if (err != NF_OK)
		return err;

	memset(fw, 0, sizeof *fw);
	fw->control_divider = config->gyro_rate_hz / POLICY_CONTROL_RATE_HZ;
	fw->grace_left = config->gyro_rate_hz * NF_BOOT_GRACE_MS / 1000u;
	fw->status.gyro_rate_hz = (uint16_t)config->gyro_rate_hz;
	fw->status.trace.motor_count = POLICY_ACTION_COUNT;
	if ((err = gyro_init(&fw->gyro, config->gyro_rate_hz, config->alignment, 0)) != NF_OK)
		return err;
	if ((err = mixer_init(&fw->mixer, config->settings, POLICY_IDLE)) != NF_OK)
		return err;
	if ((err = observation_init(&fw->observation, &terms, POLICY_ACTION_COUNT, POLICY_OBSERVATION_COUNT,
				    POLICY_CONTROL_RATE_HZ)) != NF_OK)
		return err;
	receiver_init(&fw->receiver, config->settings, config->gyro_rate_hz);
	rates_init(&fw->rates, config->settings);
	arming_init(&fw->arming);
	memcpy(fw->weights, policy_weights, sizeof fw->weights);
	fw->policy_good = selftest(&fw->policy, fw->weights);
	reset_controller(fw);
	report(fw); /* a board whose gyro never speaks must still say why it does not arm */
	return fw->policy_good ? NF_OK : NF_ERR_POLICY;
}

bool firmware_control_due(const struct firmware *fw)
{
	return fw->until_control == 0;
}

/* Brings arming up to date with everything known now. */
static void update_arming(struct firmware *fw)
{
	uint16_t channels_us[NF_CHANNEL_COUNT];

	receiver_channels(&fw->receiver, channels_us);
	if (arming_step(&fw->arming, reasons(fw, channels_us), channels_us[NF_CHANNEL_ARM] >= NF_ARM_ON_US))
		reset_controller(fw);
}

void firmware_receive(struct firmware *fw, const uint8_t *bytes, size_t count)
{
	/* Arming sees each frame, so that no "off" is lost behind an "on" of the same step. */
	while (receiver_push(&fw->receiver, &bytes, &count))
		update_arming(fw);
}

/* Is this what the policy may answer? Any NaN says no. */
static bool within_range(const float action[POLICY_ACTION_COUNT])
{
	for (int i = 0; i < POLICY_ACTION_COUNT; i++)
		if (!(action[i] >= 0.0f && action[i] <= 1.0f))
			return false;
	return true;
}

/* Gyro and setpoint to motor outputs. Returns false, the outputs unset, if the policy's answer is refused. */
static bool fly(struct firmware *fw, const struct control_trace *trace, float output[POLICY_ACTION_COUNT])
{
	const struct observation_input input = {
		.rate = trace->gyro,
		.setpoint = trace->setpoint,
		.previous_action = fw->action,
		.throttle = trace->throttle,
	};
	float observation[POLICY_OBSERVATION_COUNT];

	observation_step(&fw->observation, &input, observation);
	policy_step(&fw->policy, observation, fw->action);
	if (!within_range(fw->action))
		return false;
	mixer_step(&fw->mixer, fw->action, trace->throttle, output);
	return true;
}

static void control_step(struct firmware *fw, const float rate[3])
{
	struct control_trace *trace = &fw->status.trace;
	uint16_t channels_us[NF_CHANNEL_COUNT];
	float output[POLICY_ACTION_COUNT];

	receiver_channels(&fw->receiver, channels_us);
	rates_setpoint(&fw->rates, channels_us, trace->setpoint);
	trace->throttle = rates_throttle(channels_us);
	memcpy(trace->gyro, rate, sizeof trace->gyro);

	update_arming(fw);
	if (arming_is_armed(&fw->arming) && !fly(fw, trace, output)) {
		fw->policy_good = false; /* for good: a policy that failed once is not tried again */
		update_arming(fw);
	}
	trace->armed = arming_is_armed(&fw->arming);
	for (int i = 0; i < POLICY_ACTION_COUNT; i++)
		trace->dshot[i] = trace->armed ? dshot_value(output[i]) : NF_DSHOT_STOP;
	trace->step = fw->control_steps++;
	report(fw);
}

/* One gyro sample has passed for everything that waits. */
static void tick(struct firmware *fw)
{
	fw->until_control = (fw->until_control == 0 ? fw->control_divider : fw->until_control) - 1;
	if (fw->grace_left > 0)
		fw->grace_left--;
	receiver_tick(&fw->receiver);
}

void firmware_sample(struct firmware *fw, const struct imu_sample *sample, uint16_t dshot[POLICY_ACTION_COUNT])
{
	float rate[3];

	gyro_step(&fw->gyro, sample, rate);
	if (firmware_control_due(fw)) {
		control_step(fw, rate);
		fence();
		fw->published++;
	}
	memcpy(dshot, fw->status.trace.dshot, POLICY_ACTION_COUNT * sizeof dshot[0]);
	tick(fw);
}

const struct control_trace *firmware_trace(const struct firmware *fw)
{
	return &fw->status.trace;
}

void firmware_status(const struct firmware *fw, struct firmware_status *status)
{
	uint32_t before;

	/* The writer interrupts the reader, never the other way round, and runs to its end: a copy is whole
	 * if nothing was published during it. Control steps are far apart, the second copy is already good. */
	do {
		before = fw->published;
		fence();
		*status = fw->status;
		fence();
	} while (before != fw->published);
}
