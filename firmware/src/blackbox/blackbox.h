/* The blackbox: which device takes the log, and what is told of it. */
#ifndef NF_BLACKBOX_H
#define NF_BLACKBOX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "blackbox/log_device.h"
#include "nf_contract.h"

struct blackbox {
	const struct log_device *device; /* NULL: there is none, or it is not set */
	uint8_t chosen; /* enum nf_log_device: as the settings say */
};

/* What LOG_INFO tells. */
struct blackbox_status {
	struct log_device_status device;
	uint8_t chosen; /* enum nf_log_device */
	bool logging;
	bool lossy; /* the current or last log lacks control steps */
	uint32_t frames, dropped, bytes; /* of the current or last log; dropped: control steps */
};

/* `device` takes the logs; NULL: this chip has none of the kind that the settings choose. */
void blackbox_init(struct blackbox *blackbox, const struct nf_settings *settings, const struct log_device *device);

void blackbox_status(const struct blackbox *blackbox, struct blackbox_status *status);

/* Logs that the device keeps. Only while the motors are stopped. NF_REFUSAL_ABSENT: this device keeps none, _ORDER: a log
 * is being written, _INDEX: there are fewer, _LOG: the device failed. *later: it is under way, ask again. */
enum nf_refusal blackbox_entry(struct blackbox *blackbox, unsigned index, struct log_entry *entry, bool *later);
enum nf_refusal blackbox_read(struct blackbox *blackbox, unsigned index, uint32_t offset, uint8_t *bytes, size_t *count,
			      bool *later);
enum nf_refusal blackbox_erase(struct blackbox *blackbox, bool *later);

#endif
