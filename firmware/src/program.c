#include "program.h"

#include "blackbox/log_writer.h"
#include "common/words.h"

/* The processor was not ready for them: they count as misses, and so does the control step that follows. */
static __attribute__((noinline)) void program_lose(struct program *program, uint32_t count)
{
	program->lost += count;
	program->stats[NF_TASK_GYRO].misses += count;
	firmware_lost(program->firmware, count);
}

/* Beside the sample's counts, whether it repeated the last good one. */
static inline __attribute__((always_inline)) void program_log_sample(struct log_record *record,
								     const struct imu_sample *sample, bool repeated)
{
	struct log_sample *kept = &record->gyro[record->samples++];

	for (int i = 0; i < 3; ++i)
		kept->counts[i] = sample->gyro[i];
	kept->flags = (uint16_t)((sample->valid ? 0 : LOG_SAMPLE_INVALID) | (repeated ? LOG_SAMPLE_REPEATED : 0));
}

/* Bytes beyond those that a record holds are lost to it. */
static __attribute__((noinline)) void program_log_receiver(struct firmware *fw, struct log_record *record,
							   const uint8_t *bytes)
{
	words_copy(record->receiver_bytes, bytes, sizeof record->receiver_bytes);
	if (record->receiver_count <= NF_LOG_RECEIVER_BYTES)
		return;
	record->receiver_count = NF_LOG_RECEIVER_BYTES;
	fw->edges.flags |= LOG_EDGE_MORE_BYTES;
}

void program_sample(void *context, const struct imu_sample *sample)
{
	struct program *program = context;
	const struct hal *hal = program->hal;
	const uint32_t start = hal->cycles(hal->context);
	struct firmware *fw = program->firmware;

	if (sample->lost > 0)
		program_lose(program, sample->lost);
	const bool control_step = firmware_control_due(fw);
	struct log_record *record = program->log->open;
	uint16_t dshot[POLICY_ACTION_COUNT];

	if (control_step) {
		_Alignas(4) uint8_t bytes[HAL_RECEIVER_BYTES];
		const size_t count = hal->receiver_read(hal->context, bytes, sizeof bytes);
		firmware_receive(fw, bytes, count);
		if (record) {
			record->receiver_count = (uint16_t)count;
			if (count > 0)
				program_log_receiver(fw, record, bytes);
		}
	}
	const bool telemetry = firmware_sample(fw, sample, dshot);
	hal->motors_write(hal->context, dshot, POLICY_ACTION_COUNT, telemetry);
	if (record) {
		program_log_sample(record, sample, fw->gyro.same > 0);
		if (control_step) {
			firmware_log(fw, record);
			record->lost = program->lost;
		}
	}
	if (control_step)
		hal->trace_write(hal->context, firmware_trace(fw));

	const uint32_t cycles = hal->cycles(hal->context) - start;
	const bool missed = control_step && (hal->deadline_missed(hal->context, cycles) || program->lost > 0);
	if (control_step) {
		firmware_deadline(fw, missed);
		program->lost = 0;
		if (record) {
			record->cycles = cycles;
			if (missed)
				record->edge_flags |= LOG_EDGE_MISSED;
			log_ring_close(program->log);
		}
	}
	task_stats_add(&program->stats[control_step ? NF_TASK_CONTROL : NF_TASK_GYRO], cycles, missed);
}

void program_gyro_silent(void *context)
{
	const struct program *program = context;
	uint16_t dshot[POLICY_ACTION_COUNT];

	firmware_gyro_silent(program->firmware, dshot);
	program->hal->motors_write(program->hal->context, dshot, POLICY_ACTION_COUNT, false);
}

/* The watchdog is fed while time goes on for the core: samples come, or their silence is known. */
void program_background(void *context)
{
	struct program *program = context;
	const uint32_t now = firmware_samples(program->firmware);

	background_step(program->background);
	if (now != program->fed_at) {
		program->fed_at = now;
		program->hal->watchdog_feed(program->hal->context);
	}
}

size_t program_link(void *context, unsigned port, const uint8_t *bytes, size_t count, uint8_t *reply, size_t capacity)
{
	const struct program *program = context;

	return background_link(program->background, port, bytes, count, reply, capacity);
}

void program_link_reset(void *context, unsigned port)
{
	const struct program *program = context;

	background_link_reset(program->background, port);
}

void program_link_pause(void *context, unsigned port)
{
	const struct program *program = context;

	background_link_pause(program->background, port);
}

void program_link_lost(void *context, unsigned port)
{
	const struct program *program = context;

	background_link_lost(program->background, port);
}

bool program_link_busy(void *context, unsigned port)
{
	const struct program *program = context;

	return background_link_busy(program->background, port);
}
