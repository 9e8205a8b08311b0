/* The blackbox: makes a log of the records that the gyro's interrupt leaves in the ring, and passes it to a device. A slice
 * of it at a time, from the background; what the device or the ring cannot take is dropped and told.
 *
 * A log begins with the state of the firmware and the steps behind it: while none is written, the state is taken anew from time
 * to time and the steps since then stay in the ring. It ends some time after disarming. */
#pragma once

#include "blackbox/log_frames.h"
#include "blackbox/log_header.h"
#include "blackbox/log_ring.h"
#include "nf_contract.h"
#include "port/log_device.h"
#include "sensing/gyro.h"

/* Configuration; the pointers must outlive the blackbox. */
struct blackbox_config {
	const struct log_device *device; /* NULL: this chip has none of the kind that the settings choose */
	struct log_ring *ring; /* NULL: nothing is recorded */
	const struct gyro *gyro; /* initialized */
	struct log_about about; /* its first half */
	struct log_snapshot
		*snapshot; /* not taken; `about` has it as well. NULL: logs are without the firmware's state */
};

/* Current values that only the background has. */
struct blackbox_view {
	bool armed; /* the motors obey */
	uint32_t modes; /* bits of enum mode_index that are on */
	uint32_t step; /* the last control step */
	uint32_t samples; /* gyro samples since boot, those that silence swallowed included */
	uint8_t state, stop_cause; /* enum nf_flight_state, enum nf_stop_cause */
	float volts, amps; /* of the battery */
};

/* What is used most comes first, where short instructions reach it. */
struct blackbox {
	uint8_t phase; /* enum of blackbox.c */
	uint8_t pieces; /* frames or lines of a slice at most */
	bool switched; /* the mode BLACKBOX has a range */
	bool first; /* no frame has been written */
	bool gap; /* the next frame does not follow the last one */
	bool armed; /* as logged last */
	uint32_t sample; /* gyro samples since boot, of the record that was taken last */
	uint32_t next; /* control step that the next record should have */
	uint32_t disarmed; /* control steps since the motors stopped, in the log */
	uint32_t intra_at; /* iteration from which the next intra frame is due */
	uint32_t written, dropped, bytes; /* of the present or last log: frames, control steps, bytes */
	uint32_t out_at, out_count; /* of `out`: passed on, and in it */
	struct blackbox_config config;
	struct blackbox_view view;
	struct log_header header;
	struct log_slow slow; /* told last */
	struct log_mount mount;
	struct log_frames frames;
	uint8_t out[LOG_LINE_BYTES];
};

/* Content of LOG_INFO. */
struct blackbox_status {
	struct log_device_status device;
	uint8_t chosen; /* enum nf_log_device */
	bool logging;
	bool lossy; /* the current or last log lacks control steps */
	uint32_t frames, dropped, bytes; /* of the current or last log; dropped: control steps */
};

void blackbox_init(struct blackbox *blackbox, const struct blackbox_config *config);

/* A slice of work; called at least once a control step while the processor has time. */
void blackbox_step(struct blackbox *blackbox, const struct blackbox_view *view);

void blackbox_status(const struct blackbox *blackbox, struct blackbox_status *status);

/* Returns whether a log is being written. */
bool blackbox_logs(const struct blackbox *blackbox);

/* Logs that the device keeps. Only while the motors are stopped. NF_REFUSAL_ABSENT: this device keeps none, _ORDER: a log
 * is being written, _INDEX: there are fewer, _LOG: the device failed. *later: it is under way, ask again. */
enum nf_refusal blackbox_entry(struct blackbox *blackbox, unsigned index, struct log_entry *entry, bool *later);
enum nf_refusal blackbox_read(struct blackbox *blackbox, unsigned index, uint32_t offset, uint8_t *bytes, size_t *count,
			      bool *later);
enum nf_refusal blackbox_erase(struct blackbox *blackbox, bool *later);
