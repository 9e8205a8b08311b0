#include "hal/host/replay.h"

#include <string.h>

#include "firmware_layout.h"

_Static_assert(LOG_SUBSAMPLES_MAX <= NF_REPLAY_SAMPLES_MAX, "a record fits into a step");

static const uint16_t held[] = FIRMWARE_HELD;

uint32_t firmware_layout(void)
{
	return FIRMWARE_LAYOUT;
}

bool firmware_restore(struct firmware *fw, const uint8_t *bytes, size_t count, uint32_t layout)
{
	if (count != sizeof *fw || layout != FIRMWARE_LAYOUT)
		return false;
	uint64_t own[sizeof held / sizeof held[0]];

	for (size_t i = 0; i < sizeof held / sizeof held[0]; ++i)
		memcpy(&own[i], (const uint8_t *)fw + held[i], sizeof own[i]);
	memcpy(fw, bytes, count);
	for (size_t i = 0; i < sizeof held / sizeof held[0]; ++i)
		memcpy((uint8_t *)fw + held[i], &own[i], sizeof own[i]);
	return true;
}

static void replay_hand_over(struct firmware *fw, const struct replay_step *step)
{
	const uint32_t flags = step->edge_flags;

	fw->forbidden = step->forbidden;
	fw->voltage_gain = step->voltage_gain;
	fw->acknowledged = (flags & LOG_EDGE_ACKNOWLEDGED) != 0;
	fw->calibrate = (flags & LOG_EDGE_CALIBRATE) != 0;
	fw->weights = flags & LOG_EDGE_WEIGHTS_BAD  ? WEIGHTS_BAD :
		      flags & LOG_EDGE_WEIGHTS_GOOD ? WEIGHTS_RENEWED :
						      WEIGHTS_KNOWN;
	fw->posted = (flags & LOG_EDGE_POSTED) != 0;
	if (fw->posted)
		memcpy(fw->posted_us, step->receiver_bytes, sizeof fw->posted_us);
}

/* The temperature, which no log has and nothing but telemetry uses, makes a sample differ from the one before. */
static struct imu_sample replay_sample(const struct firmware *fw, const struct replay_step *step, size_t index)
{
	const struct log_sample *kept = &step->gyro[index];
	const bool repeated = (kept->flags & LOG_SAMPLE_REPEATED) != 0;
	struct imu_sample sample = fw->gyro.last;

	memcpy(sample.gyro, kept->counts, sizeof sample.gyro);
	sample.valid = !(kept->flags & LOG_SAMPLE_INVALID);
	sample.lost = 0;
	if (!repeated) {
		memcpy(sample.accel, step->accel, sizeof sample.accel);
		sample.temperature ^= 1;
	}
	return sample;
}

enum replay_result replay_run(struct firmware *fw, const struct replay_step *step, uint16_t dshot[POLICY_ACTION_COUNT])
{
	const uint32_t flags = step->edge_flags;
	const bool posted = (flags & LOG_EDGE_POSTED) != 0;

	if (step->samples == 0 || step->samples > NF_REPLAY_SAMPLES_MAX || step->receiver_count > NF_LOG_RECEIVER_BYTES)
		return REPLAY_SIZE;
	if (flags & (LOG_EDGE_MORE_BYTES | LOG_EDGE_BENCH))
		return REPLAY_UNKNOWN;
	replay_hand_over(fw, step);
	for (uint32_t silences = flags / LOG_EDGE_SILENCE; silences > 0; --silences)
		firmware_gyro_silent(fw, dshot);
	const size_t last = step->samples - 1u;
	for (size_t i = 0; i < last; ++i) {
		if (firmware_control_due(fw))
			return REPLAY_EARLY;
		const struct imu_sample sample = replay_sample(fw, step, i);
		(void)firmware_sample(fw, &sample, dshot);
	}
	firmware_lost(fw, step->lost);
	if (!firmware_control_due(fw))
		return REPLAY_LATE;
	if (fw->rotors.on)
		firmware_rotors(fw, step->rotors);
	firmware_receive(fw, step->receiver_bytes, posted ? 0 : step->receiver_count);
	const struct imu_sample sample = replay_sample(fw, step, last);
	(void)firmware_sample(fw, &sample, dshot);
	firmware_deadline(fw, (flags & LOG_EDGE_MISSED) != 0);
	return REPLAY_DONE;
}
