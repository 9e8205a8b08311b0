/* The library's device of the log: memory that its caller drains. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "port/log_device.h"

#define LOG_PIPE_BYTES 65536u

struct log_pipe {
	struct log_device device;
	uint32_t capacity; /* that is used; less makes it a device that does not follow */
	uint32_t written, taken; /* bytes since the begin; they wrap */
	bool drained; /* somebody takes what is written */
	bool logging;
	uint8_t bytes[LOG_PIPE_BYTES];
};

void log_pipe_init(struct log_pipe *pipe);

/* Takes up to `capacity` bytes out; returns how many. */
size_t log_pipe_drain(struct log_pipe *pipe, uint8_t *bytes, size_t capacity);
