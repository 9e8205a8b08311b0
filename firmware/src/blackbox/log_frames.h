/* A log's frames: what each field is, how it is predicted and written, in one table from which the header's lines and the
 * frames are made. docs/reference/blackbox-format.md tells the fields. */
#pragma once

#include "blackbox/log_record.h"
#include "common/printer.h"
#include "nf_contract.h"

#define LOG_INTRA_INTERVAL 32u /* control steps; a multiple of each divider */
#define LOG_COUNTS_G (NF_ACCEL_COUNTS / NF_ACCEL_FULL_SCALE_G) /* of the accelerometer, for 1 g */
#define LOG_CHIRP_FIELDS 4u /* of debug, before the actions */
#define LOG_CHIRP_PHASE_SCALE 5000.0f /* of a radian, as the ecosystem tells it */
#define LOG_ACTION_SCALE 1000.0f
#define LOG_OBSERVATION_SCALE 100.0f
#define LOG_BOXES 0xFFFFu /* bits of log_flags that are the ecosystem's modes; ours lie above them */
#define LOG_NAME_LINE_MAX 1000u /* characters of the fields' names: the ecosystem's tools read lines of 1,024 */
#define LOG_RECEIVER_WORDS (NF_LOG_RECEIVER_BYTES / 4u)

/* Lines of the header about the fields of a frame. */
enum log_field_line { LOG_LINE_NAME, LOG_LINE_SIGNED, LOG_LINE_PREDICTOR, LOG_LINE_ENCODING };

enum log_frame { LOG_INTRA, LOG_INTER, LOG_FRAME_COUNT };

struct log_field {
	uint8_t row; /* of the table */
	uint8_t index; /* within the row */
	uint8_t predictor[LOG_FRAME_COUNT];
	uint8_t encoding[LOG_FRAME_COUNT];
};

struct log_frames {
	unsigned count; /* of `fields` */
	uint32_t left_out; /* bit field of enum nf_log_group: those asked for, and those that found no room */
	unsigned samples; /* gyro samples a control step */
	bool rotors; /* the ESCs tell rotor speeds */
	unsigned observed; /* inputs of the policy that found room, the first ones */
	unsigned present; /* which of the values is the present frame's; the one before it is the last frame's .. */
	struct log_field fields[NF_LOG_FIELDS_MAX]; /* of the main frames */
	int32_t values[3][NF_LOG_FIELDS_MAX];
};

/* Mounting of the chip in the aircraft, and the gyro's bias at rest; wiring of the motors. */
struct log_mount {
	float turn[3][3]; /* from the chip's axes to the body's */
	const float *bias; /* rad/s, body axes */
	uint8_t outputs[POLICY_ACTION_COUNT]; /* of each motor */
};

/* A control step, and what the background knows beside it. */
struct log_step {
	const struct log_record *record;
	uint32_t iteration; /* control steps since the log's first */
	uint32_t time_us; /* since boot */
	int32_t volts_cv; /* of the battery, 0.01 V */
	int32_t amps_ca; /* 0.01 A */
	const struct log_mount *mount;
};

/* Content of a slow frame. */
struct log_slow {
	uint32_t flags; /* as log_flags */
	uint32_t failsafe_phase, receiver_good, channels_good;
	uint32_t step; /* iteration that it belongs to */
	uint32_t forbidden, gain, edges; /* gain: bits of the float */
	uint32_t receiver_count;
	uint32_t receiver[LOG_RECEIVER_WORDS]; /* its bytes, little-endian */
	uint32_t dropped; /* control steps that this log lacks so far */
	uint32_t motors; /* bit fields: whose ESC is silent; from bit 8 on: which are weak */
};

/* Chooses the fields of a log. `left_out`: the setting; rotors: the ESCs tell rotor speeds. Fields that do not fit into a frame of NF_LOG_FRAME_BYTES_MAX
 * or on the line of names are omitted as well: first the policy's inputs, which a replay computes again, then whole
 * groups. */
void log_frames_init(struct log_frames *frames, uint32_t left_out, unsigned samples, bool rotors);

/* The next main frame is the first, or the first behind a gap: an intra frame. Its values are predicted from nothing. */
size_t log_frames_intra(struct log_frames *frames, const struct log_step *step, uint8_t bytes[NF_LOG_FRAME_BYTES_MAX]);

/* A frame behind another one. */
size_t log_frames_inter(struct log_frames *frames, const struct log_step *step, uint8_t bytes[NF_LOG_FRAME_BYTES_MAX]);

/* Betaflight's boxes of this step in the lower 16 bits; in the upper half: bit 0 the PID flies, 1-3 enum nf_flight_state, 4-7
 * enum nf_stop_cause, 8-11 enum nf_fallback_cause, 12-15 enum nf_fallback_cause that refuses the policy. */
uint32_t log_flags(const struct log_record *record);

/* The same flags once the motors have been stopped so, without a control step. */
uint32_t log_flags_stopped(uint32_t flags, unsigned state, unsigned stop_cause);

void log_slow_load(struct log_slow *slow, const struct log_step *step, const struct log_frames *frames,
		   uint32_t dropped);

/* Does `slow` tell more than `last` did? */
bool log_slow_tells(const struct log_slow *slow, const struct log_slow *last);

size_t log_frames_slow(const struct log_slow *slow, uint8_t bytes[NF_LOG_FRAME_BYTES_MAX]);

size_t log_frames_event(uint8_t bytes[NF_LOG_FRAME_BYTES_MAX], enum nf_log_event event, const uint32_t values[],
			unsigned count);

/* One line of the header about the fields, without its name. */
void log_frames_line(struct printer *out, const struct log_frames *frames, enum log_frame frame,
		     enum log_field_line line);
void log_slow_line(struct printer *out, enum log_field_line line);
