#define _GNU_SOURCE
#include "hal/host/log_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static void log_file_step(void *context)
{
}

static void log_file_status(void *context, struct log_device_status *status)
{
	const struct log_file *file = context;

	*status =
		(struct log_device_status){ .state = file->state, .error = file->error, .logs = (uint16_t)file->logs };
}

static enum log_answer log_file_begin(void *context)
{
	struct log_file *file = context;

	file->state = NF_LOG_STATE_LOGGING;
	file->error = NF_LOG_ERROR_NONE;
	file->begun = true;
	file->kept = false;
	return LOG_DONE;
}

/* Notes where bytes of the current log came to lie: appended ones end where the descriptor stands. */
static void log_file_note(struct log_file *file, uint32_t bytes)
{
	const bool first = file->begun;

	if (file->reader < 0 || bytes == 0u)
		return;
	file->begun = false;
	if (first && file->logs < LOG_FILE_LOGS) {
		file->places[file->logs++] = (struct log_file_place){ .at = lseek(file->descriptor, 0, SEEK_CUR) -
									    (off_t)bytes };
		file->kept = true;
		if (file->logs == LOG_FILE_LOGS)
			fprintf(stderr, "neuroflight: %u logs of this run can be listed; later ones are only in %s\n",
				file->logs, file->path);
	}
	if (file->kept) {
		struct log_file_place *const place = &file->places[file->logs - 1u];

		place->bytes += bytes < UINT32_MAX - place->bytes ? bytes : UINT32_MAX - place->bytes;
	}
}

/* Reports once that the file takes no more bytes, for instance on a full disk; the flight continues. */
static size_t log_file_write(void *context, const uint8_t *bytes, size_t count)
{
	struct log_file *file = context;
	const ssize_t written = count > 0 ? write(file->descriptor, bytes, count) : 0;

	if (written >= 0) {
		log_file_note(file, (uint32_t)written);
		return (size_t)written;
	}
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

static enum log_answer log_file_entry(void *context, unsigned index, struct log_entry *entry)
{
	const struct log_file *file = context;

	if (index >= file->logs)
		return LOG_FAILED;
	*entry = (struct log_entry){ .bytes = file->places[index].bytes };
	snprintf(entry->name, sizeof entry->name, NF_LOG_FILE_PREFIX "%05u" NF_LOG_FILE_SUFFIX, (index + 1u) % 100000u);
	return LOG_DONE;
}

static enum log_answer log_file_read(void *context, unsigned index, uint32_t offset, uint8_t *bytes, size_t *count)
{
	struct log_file *file = context;

	if (index >= file->logs)
		return LOG_FAILED;
	const struct log_file_place *place = &file->places[index];
	const uint32_t left = offset < place->bytes ? place->bytes - offset : 0u;
	const size_t wanted = *count < left ? *count : left;
	const ssize_t got = wanted > 0u ? pread(file->reader, bytes, wanted, place->at + (off_t)offset) : 0;

	/* Nothing where the log was: somebody has made the file shorter. */
	if (got < 0 || (got == 0 && wanted > 0u)) {
		file->error = NF_LOG_ERROR_READ;
		return LOG_FAILED;
	}
	*count = (size_t)got;
	return LOG_DONE;
}

/* Reads the file back if it is an ordinary one that may be read; a pipe or a device only takes logs. */
static void log_file_open_reader(struct log_file *file)
{
	struct stat about;

	if (fstat(file->descriptor, &about) != 0 || !S_ISREG(about.st_mode))
		return;
	file->reader = open(file->path, O_RDONLY | O_CLOEXEC);
	if (file->reader < 0)
		return;
	file->device.entry = log_file_entry;
	file->device.read = log_file_read;
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
		.reader = -1,
		.state = NF_LOG_STATE_READY,
	};
	if (file->descriptor >= 0) {
		log_file_open_reader(file);
		return true;
	}
	fprintf(stderr, "neuroflight: --blackbox: cannot write %s: %s; name another file\n", path, strerror(errno));
	return false;
}
