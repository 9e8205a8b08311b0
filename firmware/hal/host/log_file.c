#define _GNU_SOURCE
#include "hal/host/log_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static void log_file_step(void *context)
{
	(void)context;
}

static void log_file_status(void *context, struct log_device_status *status)
{
	const struct log_file *file = context;

	*status = (struct log_device_status){ .state = file->state, .error = file->error };
}

static enum log_answer log_file_begin(void *context)
{
	struct log_file *file = context;

	file->state = NF_LOG_STATE_LOGGING;
	file->error = NF_LOG_ERROR_NONE;
	return LOG_DONE;
}

/* A file that takes no more, of a full disk or another, is told once; the flight goes on. */
static size_t log_file_write(void *context, const uint8_t *bytes, size_t count)
{
	struct log_file *file = context;
	const ssize_t written = count > 0 ? write(file->descriptor, bytes, count) : 0;

	if (written >= 0)
		return (size_t)written;
	if (errno == EINTR || errno == EAGAIN)
		return 0;
	fprintf(stderr, "neuroflight: cannot go on with the log %s: %s; nothing more is logged\n", file->path,
		strerror(errno));
	file->state = NF_LOG_STATE_FAULT;
	file->error = NF_LOG_ERROR_WRITE;
	return 0;
}

static enum log_answer log_file_end(void *context)
{
	struct log_file *file = context;

	if (file->state == NF_LOG_STATE_LOGGING)
		file->state = NF_LOG_STATE_READY;
	return LOG_DONE;
}

bool log_file_open(struct log_file *file, const char *path)
{
	*file = (struct log_file){
		.device = {
			.context = file,
			.step = log_file_step,
			.status = log_file_status,
			.begin = log_file_begin,
			.write = log_file_write,
			.end = log_file_end,
		},
		.path = path,
		.descriptor = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666),
		.state = NF_LOG_STATE_READY,
	};
	if (file->descriptor >= 0)
		return true;
	fprintf(stderr, "neuroflight: --blackbox: cannot write %s: %s; name another file\n", path, strerror(errno));
	return false;
}
