#include "msp/msp_stream.h"

#include "msp/msp.h"
#include "msp/msp_payload.h"
#include "nf_contract.h"
#include "policy.h"

#define FIXED_BYTES 43u /* of a record without values of motors, observation and action */
#define PAYLOAD_MAX (FIXED_BYTES + 2u * POLICY_ACTION_COUNT + 4u * (POLICY_OBSERVATION_COUNT + POLICY_ACTION_COUNT))

unsigned msp_stream_start(struct msp_stream *stream, unsigned rate_hz, uint32_t step)
{
	unsigned granted = rate_hz < NF_MSP_STREAM_RATE_MAX_HZ ? rate_hz : NF_MSP_STREAM_RATE_MAX_HZ;

	msp_stream_stop(stream);
	while (granted > 0 && POLICY_CONTROL_RATE_HZ % granted != 0)
		--granted;
	if (granted > 0)
		*stream = (struct msp_stream){ .divider = POLICY_CONTROL_RATE_HZ / granted, .due = step + 1 };
	return granted;
}

void msp_stream_stop(struct msp_stream *stream)
{
	*stream = (struct msp_stream){ 0 };
}

/* The number of the step wraps: a difference above half its range means not due yet. */
bool msp_stream_due(const struct msp_stream *stream, uint32_t step)
{
	return stream->divider > 0 && step - stream->due <= UINT32_MAX / 2;
}

static void msp_stream_put_floats(struct msp_writer *w, const float values[], unsigned count)
{
	for (unsigned i = 0; i < count; ++i)
		msp_put_float(w, values[i]);
}

static void msp_stream_put_record(struct msp_writer *w, const struct control_record *record)
{
	const struct control_trace *trace = &record->trace;

	msp_put_u32(w, trace->step);
	msp_put_u32(w, record->cycles);
	msp_put_u8(w, record->state);
	msp_put_u8(w, (trace->armed ? NF_MSP_STREAM_ARMED : 0u) | (record->pid_flies ? NF_MSP_STREAM_PID : 0u));
	msp_stream_put_floats(w, trace->setpoint, 3);
	msp_stream_put_floats(w, trace->gyro, 3);
	msp_put_float(w, trace->throttle);
	msp_put_u8(w, trace->motor_count);
	for (unsigned i = 0; i < trace->motor_count; ++i)
		msp_put_u16(w, trace->dshot[i]);
	msp_put_u8(w, record->observation_count);
	msp_stream_put_floats(w, record->observation, record->observation_count);
	msp_put_u8(w, record->action_count);
	msp_stream_put_floats(w, record->action, record->action_count);
}

size_t msp_stream_write(struct msp_stream *stream, const struct control_record *record, uint8_t *frame, size_t capacity)
{
	const uint32_t passed = (record->trace.step - stream->due) / stream->divider;
	uint8_t payload[PAYLOAD_MAX];
	struct msp_writer writer = { payload, payload + sizeof payload };

	stream->due += (passed + 1) * stream->divider;
	stream->sequence = (uint16_t)(stream->sequence + passed + 1);
	msp_put_u16(&writer, (uint16_t)(stream->sequence - 1u));
	msp_stream_put_record(&writer, record);
	return msp_frame(2, NF_MSP_STREAM_SAMPLE, false, payload, (size_t)(writer.at - payload), frame, capacity);
}
