/* Where a log goes, and where logs that are kept can be read again. Chips offer such devices; blackbox.c writes to the one
 * that the settings name.
 *
 * All functions are called from the background and never wait: what takes longer goes on in `step`. */
#pragma once

#include "nf_contract.h"

struct log_device_status {
	uint8_t state; /* enum nf_log_state */
	uint8_t error; /* enum nf_log_error: the last one; it stays until a log begins well */
	bool looking; /* for logs and files: there may be more than these */
	uint16_t logs; /* that can be read back */
	uint16_t empty; /* files that can take a log */
	uint32_t capacity_kb; /* of all files for logs */
	uint32_t free_kb; /* of the empty ones */
};

/* A log that is kept. */
struct log_entry {
	char name[13]; /* 8.3, ended by 0 */
	uint32_t bytes; /* of the log: its file may be longer */
};

enum log_answer {
	LOG_DONE,
	LOG_LATER, /* it is under way: ask again */
	LOG_FAILED, /* as `error` of the status says, or there is no such log */
};

struct log_device {
	void *context;

	/* Work that is due: finding a card, passing bytes on. Called at least once a background round. */
	void (*step)(void *context);
	void (*status)(void *context, struct log_device_status *status);

	/* A log begins. LOG_FAILED: there is nothing to write it to now. */
	enum log_answer (*begin)(void *context);
	/* Takes bytes of the log, as many as there is room for now; returns how many. Accepted bytes may still be
	 * lost if the card is pulled; the status then reports it. */
	size_t (*write)(void *context, const uint8_t *bytes, size_t count);
	/* No more bytes of this log follow. Asked until it is not LOG_LATER. */
	enum log_answer (*end)(void *context);

	/* Reading back and erasing, only while no log is written; NULL where the device cannot. */
	enum log_answer (*entry)(void *context, unsigned index, struct log_entry *entry);
	/* Up to *count bytes from `offset` on; sets *count to what was read, 0 behind the end. */
	enum log_answer (*read)(void *context, unsigned index, uint32_t offset, uint8_t *bytes, size_t *count);
	/* Makes all files empty again. */
	enum log_answer (*erase)(void *context);
};
