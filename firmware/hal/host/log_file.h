/* The host program's device of the log: a file that logs are appended to. */
#ifndef NF_HOST_LOG_FILE_H
#define NF_HOST_LOG_FILE_H

#include <stdbool.h>
#include <stdint.h>

#include "blackbox/log_device.h"

struct log_file {
	struct log_device device;
	const char *path;
	int descriptor;
	uint8_t state, error; /* enum nf_log_state, enum nf_log_error */
};

/* Opens the file, made if there is none, and leaves what it holds. False after one line on stderr: it cannot be written. */
bool log_file_open(struct log_file *file, const char *path);

#endif
