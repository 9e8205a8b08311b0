/* The lines that a log begins with: its fields, what the ecosystem's tools want to know, and (nf_) what it takes to fly its
 * inputs again. docs/reference/blackbox-format.md tells each. */
#pragma once

#include "blackbox/log_frames.h"
#include "blackbox/log_snapshot.h"
#include "nf_contract.h"
#include "storage/policy_slots.h"

#define LOG_LINE_BYTES (LOG_NAME_LINE_MAX + 24u) /* of the longest line */

/* Sources of the header lines; constant from boot on except for the second half. */
struct log_about {
	const struct nf_settings *settings;
	const struct policy_slots *slots;
	const char *maker, *target; /* of the board */
	float pid_idle; /* motor fraction at zero thrust of the PID */
	enum nf_mix pid_mix; /* of its outputs with the pilot's thrust */
	uint32_t gyro_mean; /* gyro samples that controllers see the mean of; 0: the newest alone */
	struct nf_image_header image; /* zeros: there is none */
	const struct log_snapshot *snapshot; /* of the firmware; NULL, or not taken: the log cannot be replayed */
	uint32_t first_step; /* control step since boot of the first frame */
	int32_t volts_cv; /* 0.01 V */
};

/* A header under way; zeros: at its begin. */
struct log_header {
	unsigned line; /* of those that are always there, then */
	unsigned setting;
	unsigned debug;
	size_t state; /* bytes of it that are told */
	unsigned state_line;
};

/* Writes the next line, its end included; returns its characters, 0 behind the last one. */
size_t log_header_next(struct log_header *header, const struct log_about *about, const struct log_frames *frames,
		       char text[LOG_LINE_BYTES]);
