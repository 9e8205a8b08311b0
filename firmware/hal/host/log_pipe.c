#include "hal/host/log_pipe.h"

static void log_pipe_step(void *context)
{
}

static void log_pipe_status(void *context, struct log_device_status *status)
{
	const struct log_pipe *pipe = context;

	*status = (struct log_device_status){
		.state = !pipe->drained ? NF_LOG_STATE_ABSENT :
			 pipe->logging  ? NF_LOG_STATE_LOGGING :
					  NF_LOG_STATE_READY,
	};
}

static enum log_answer log_pipe_begin(void *context)
{
	struct log_pipe *pipe = context;

	pipe->logging = true;
	return LOG_DONE;
}

static size_t log_pipe_write(void *context, const uint8_t *bytes, size_t count)
{
	struct log_pipe *pipe = context;
	size_t taken = 0;

	for (; taken < count && pipe->written - pipe->taken < pipe->capacity; ++taken)
		pipe->bytes[pipe->written++ % LOG_PIPE_BYTES] = bytes[taken];
	return taken;
}

static enum log_answer log_pipe_end(void *context)
{
	struct log_pipe *pipe = context;

	pipe->logging = false;
	return LOG_DONE;
}

void log_pipe_init(struct log_pipe *pipe)
{
	pipe->device = (struct log_device){
		.context = pipe,
		.step = log_pipe_step,
		.status = log_pipe_status,
		.begin = log_pipe_begin,
		.write = log_pipe_write,
		.end = log_pipe_end,
	};
	pipe->capacity = LOG_PIPE_BYTES;
	pipe->written = pipe->taken = 0;
	pipe->drained = pipe->logging = false;
}

size_t log_pipe_drain(struct log_pipe *pipe, uint8_t *bytes, size_t capacity)
{
	size_t count = 0;

	pipe->drained = true;
	for (; count < capacity && pipe->taken != pipe->written; ++count)
		bytes[count] = pipe->bytes[pipe->taken++ % LOG_PIPE_BYTES];
	return count;
}
