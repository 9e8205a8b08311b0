#include "runtime.h"

#include "blackbox/log_writer.h"
#include "common/words.h"

/* Samples that arrived while the processor was busy count as missed, and so does the following control step. */
static __attribute__((noinline)) void runtime_lose(struct runtime *runtime, uint32_t count)
{
	runtime->lost += count;
	runtime->stats[NF_TASK_GYRO].misses += count;
	firmware_lost(runtime->firmware, count);
}

/* Beside the sample's counts, whether it repeated the last good one. */
static inline __attribute__((always_inline)) void runtime_log_sample(struct log_record *record,
								     const struct imu_sample *sample, bool repeated)
{
	struct log_sample *kept = &record->gyro[record->samples++];

	for (int i = 0; i < 3; ++i)
		kept->counts[i] = sample->gyro[i];
	kept->flags = (uint16_t)((sample->valid ? 0 : LOG_SAMPLE_INVALID) | (repeated ? LOG_SAMPLE_REPEATED : 0));
}

/* Bytes beyond those that a record holds are lost to it. */
static __attribute__((noinline)) void runtime_log_receiver(struct firmware *fw, struct log_record *record,
							   const uint8_t *bytes)
{
	words_copy(record->receiver_bytes, bytes, sizeof record->receiver_bytes);
	if (record->receiver_count <= NF_LOG_RECEIVER_BYTES)
		return;
	record->receiver_count = NF_LOG_RECEIVER_BYTES;
	fw->edges.flags |= LOG_EDGE_MORE_BYTES;
}

/* Without the setting no output is asked. */
static __attribute__((noinline)) void runtime_rotors(const struct hal *hal, struct firmware *fw)
{
	_Alignas(4) uint16_t words[NF_MOTOR_COUNT_MAX];

	hal->rotors_read(hal->context, words);
	firmware_rotors(fw, words);
}

void runtime_sample(void *context, const struct imu_sample *sample)
{
	struct runtime *runtime = context;
	const struct hal *hal = runtime->hal;
	const uint32_t start = hal->cycles(hal->context);
	struct firmware *fw = runtime->firmware;

	if (sample->lost > 0)
		runtime_lose(runtime, sample->lost);
	const bool control_step = firmware_control_due(fw);
	struct log_record *record = runtime->log->open;
	uint16_t dshot[POLICY_ACTION_COUNT];

	if (control_step) {
		_Alignas(4) uint8_t bytes[HAL_RECEIVER_BYTES];
		const size_t count = hal->receiver_read(hal->context, bytes, sizeof bytes);
		firmware_receive(fw, bytes, count);
		if (fw->rotors.on)
			runtime_rotors(hal, fw);
		if (record) {
			record->receiver_count = (uint16_t)count;
			if (count > 0)
				runtime_log_receiver(fw, record, bytes);
		}
	}
	const bool telemetry = firmware_sample(fw, sample, dshot);
	if (!hal->motors_write(hal->context, dshot, POLICY_ACTION_COUNT, telemetry) && telemetry)
		dshot_command_unsent(&fw->dshot_command);
	if (record) {
		runtime_log_sample(record, sample, fw->gyro.same > 0);
		if (control_step) {
			firmware_log(fw, record);
			record->lost = runtime->lost;
		}
	}
	if (control_step)
		hal->trace_write(hal->context, firmware_trace(fw));

	const uint32_t cycles = hal->cycles(hal->context) - start;
	const bool missed = control_step && (hal->deadline_missed(hal->context, cycles) || runtime->lost > 0);
	if (control_step) {
		firmware_deadline(fw, missed);
		runtime->lost = 0;
		if (record) {
			record->cycles = cycles;
			if (missed)
				record->edge_flags |= LOG_EDGE_MISSED;
			log_ring_close(runtime->log);
		}
	}
	task_stats_add(&runtime->stats[control_step ? NF_TASK_CONTROL : NF_TASK_GYRO], cycles, missed);
}

void runtime_gyro_silent(void *context)
{
	const struct runtime *runtime = context;
	uint16_t dshot[POLICY_ACTION_COUNT];

	firmware_gyro_silent(runtime->firmware, dshot);
	(void)runtime->hal->motors_write(runtime->hal->context, dshot, POLICY_ACTION_COUNT, false);
}

/* The watchdog is fed only while the core's time advances: samples arrive, or the gyro is known to be silent. */
void runtime_background(void *context)
{
	struct runtime *runtime = context;
	const uint32_t now = firmware_samples(runtime->firmware);

	background_step(runtime->background);
	if (now != runtime->fed_at) {
		runtime->fed_at = now;
		runtime->hal->watchdog_feed(runtime->hal->context);
	}
}

size_t runtime_link(void *context, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply, size_t capacity)
{
	const struct runtime *runtime = context;

	return background_link(runtime->background, port, bytes, count, reply, capacity);
}

void runtime_link_reset(void *context, unsigned port)
{
	const struct runtime *runtime = context;

	msp_port_reset(&runtime->background->ports[port]);
}

void runtime_link_pause(void *context, unsigned port)
{
	const struct runtime *runtime = context;

	msp_port_pause(&runtime->background->ports[port]);
}

void runtime_link_lost(void *context, unsigned port)
{
	const struct runtime *runtime = context;

	msp_port_lost(&runtime->background->ports[port]);
}

bool runtime_link_busy(void *context, unsigned port)
{
	const struct runtime *runtime = context;

	return msp_port_busy(&runtime->background->ports[port]);
}

void runtime_name(void *context, char *text, size_t capacity)
{
	const struct runtime *runtime = context;

	background_name(runtime->background, text, capacity);
}
