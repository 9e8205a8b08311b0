/* Functions for the background: inputs to the control path, and copies of its state. */
#include <string.h>

#include "common/fence.h"
#include "firmware.h"

void firmware_forbid(struct firmware *fw, enum nf_arming_reason reason, bool holds)
{
	const uint32_t bit = 1u << reason;

	fw->forbidden = holds ? fw->forbidden | bit : fw->forbidden & ~bit;
	fence();
}

void firmware_calibrate(struct firmware *fw)
{
	fw->calibrate = true;
}

void firmware_tune_init(struct firmware *fw, const struct nf_settings *settings)
{
	rates_init(&fw->rates, settings);
	pid_init(&fw->control.pid, fw->control.pid.gains, settings);
	fence();
}

void firmware_acknowledge(struct firmware *fw)
{
	fw->acknowledged = true;
	fence();
}

void firmware_weights(struct firmware *fw, bool good)
{
	fw->weights = good ? WEIGHTS_RENEWED : WEIGHTS_BAD;
	fence();
}

void firmware_power(struct firmware *fw, float voltage)
{
	fw->voltage_gain = pid_compensation(fw->control.pid.gains, voltage);
}

bool firmware_armed(const struct firmware *fw)
{
	fence();
	return fw->status.trace.armed;
}

bool firmware_stopped(const struct firmware *fw)
{
	const struct motor_test *test = &fw->motor_test;

	fence();
	return !fw->status.trace.armed && !motor_test_open(test) && test->left == 0 &&
	       !dshot_command_busy(&fw->dshot_command);
}

enum nf_refusal firmware_post(struct firmware *fw, const uint16_t channels_us[NF_CHANNEL_COUNT])
{
	if (fw->receiver.protocol != NF_RECEIVER_PROTOCOL_MSP)
		return NF_REFUSAL_ABSENT;
	if (fw->posted)
		return NF_REFUSAL_ORDER;
	memcpy(fw->posted_us, channels_us, sizeof fw->posted_us);
	fence();
	fw->posted = true;
	return NF_REFUSAL_NONE;
}

uint32_t firmware_samples(const struct firmware *fw)
{
	return fw->samples;
}

void firmware_status(const struct firmware *fw, struct firmware_status *status)
{
	struct attitude attitude;
	uint32_t before;

	/* The writer interrupts the reader, never the other way round, and runs to its end: a copy is whole
	 * if nothing was published during it. Control steps are far apart, the second copy is already good. */
	do {
		before = fw->published;
		fence();
		*status = fw->status;
		attitude = fw->attitude;
		fence();
	} while (before != fw->published);
	if (status->attitude_known)
		attitude_euler_deg(&attitude, status->attitude_deg);
}

void firmware_record(const struct firmware *fw, const uint32_t *cycles, struct control_record *record)
{
	uint32_t before;

	do { /* as firmware_status */
		before = fw->published;
		fence();
		record->trace = fw->status.trace;
		record->cycles = *cycles;
		record->state = fw->status.state;
		record->pid_flies = fw->status.pid_flies;
		memcpy(record->observation, fw->control.seen, sizeof fw->control.seen);
		memcpy(record->action, fw->control.action, sizeof fw->control.action);
		fence();
	} while (before != fw->published);
	record->action_count = record->trace.armed ? POLICY_ACTION_COUNT : 0;
	record->observation_count = record->trace.armed && !record->pid_flies ? POLICY_OBSERVATION_COUNT : 0;
}
