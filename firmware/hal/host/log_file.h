/* The host program's device of the log: a file that logs are appended to. Those of this run of the program can be read
 * back while the file is an ordinary one; what it held before is left alone, and not listed. */
#pragma once

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>

#include "port/log_device.h"

/* Logs of a run that can be read back. Later ones are in the file, but not listed, which is told once: places never move
 * while somebody reads. */
#define LOG_FILE_LOGS 64u

/* Where a log lies in the file. */
struct log_file_place {
	off_t at;
	uint32_t bytes;
};

struct log_file {
	struct log_device device;
	const char *path;
	int descriptor; /* to append */
	int reader;     /* -1: the file cannot be read back */
	struct log_file_place places[LOG_FILE_LOGS];
	unsigned logs; /* that have a place, each with a byte at least */
	bool begun;    /* a log, of which no byte is written yet */
	bool kept;     /* the last place is the current log's */
	uint8_t state, error; /* enum nf_log_state, enum nf_log_error */
};

/* Opens the file, made if there is none, and leaves what it holds. False after one line on stderr: it cannot be written. */
bool log_file_open(struct log_file *file, const char *path);
