/* Copies a control step into a blackbox record. */
#include <stddef.h>
#include <stdint.h>

#include "blackbox/log_record.h"
#include "common/words.h"
#include "firmware.h"

/* Members that are neighbours in the firmware and in a record are copied together. */
#define RECORD(member) offsetof(struct log_record, member)
#define STATUS(member) offsetof(struct firmware_status, member)
#define SAME_PLACE(member, from) \
	_Static_assert(RECORD(member) - RECORD(from) == STATUS(member) - STATUS(from), "not as in the status: " #member)
#define TOLD (RECORD(modes) - RECORD(trace))
_Static_assert(STATUS(trace) == 0 && STATUS(channels_us) == RECORD(sticks_us) && NF_CHANNEL_YAW + 1 == LOG_STICKS,
	       "the sticks are the first channels");
SAME_PLACE(arming_reasons, trace);
#define CONDITIONS (RECORD(attitude) - RECORD(modes))
_Static_assert(STATUS(modes) % 4u == 0 && CONDITIONS % 4u == 0, "whole words");
SAME_PLACE(receiver_good, modes);
SAME_PLACE(policy_good, modes);
SAME_PLACE(pid_built_in, modes);
SAME_PLACE(pid_flies, modes);
SAME_PLACE(state, modes);
SAME_PLACE(stop_cause, modes);
SAME_PLACE(fallback_cause, modes);
SAME_PLACE(refused_cause, modes);
SAME_PLACE(gyro_health, modes);
SAME_PLACE(receiver_quality, modes);
SAME_PLACE(attitude_known, modes);
#define ANSWER (RECORD(accel) - RECORD(observation))
_Static_assert(offsetof(struct control, action) - offsetof(struct control, seen) ==
		       RECORD(action) - RECORD(observation),
	       "observation and action");
_Static_assert(RECORD(chirp) % 4u == 0 && sizeof(struct chirp_sweep) % 4u == 0, "whole words");
#define EDGES (RECORD(sample) - RECORD(forbidden))
_Static_assert(sizeof(struct firmware_edges) == EDGES &&
		       offsetof(struct firmware_edges, flags) == RECORD(edge_flags) - RECORD(forbidden),
	       "edges");
_Static_assert(RECORD(rotors) % 4u == 0 &&
		       (offsetof(struct firmware, rotors) + offsetof(struct rotors, words)) % 4u == 0,
	       "whole words");
#define MEASURED (RECORD(gyro) - RECORD(accel))
#define LAST (offsetof(struct firmware, gyro) + offsetof(struct gyro, last) + offsetof(struct imu_sample, accel))
_Static_assert(LAST % 4u == 0 && RECORD(temperature) - RECORD(accel) ==
					 offsetof(struct imu_sample, temperature) - offsetof(struct imu_sample, accel),
	       "accelerometer and temperature");

void firmware_log(const struct firmware *fw, struct log_record *record)
{
	words_copy(&record->trace, &fw->status, TOLD);
	words_copy(&record->modes, &fw->status.modes, CONDITIONS);
	words_copy(record->attitude, fw->attitude.q, sizeof record->attitude);
	words_copy(&record->chirp, &fw->chirp.sweep, sizeof record->chirp);
	words_copy(&record->forbidden, &fw->edges, EDGES);
	/* A motor test or a command forbids arming, and no armed motors have one. */
	if (record->arming_reasons & SAFETY_REASON(MOTOR_TEST))
		record->edge_flags |= LOG_EDGE_BENCH;
	if (record->edge_flags & LOG_EDGE_POSTED) {
		record->receiver_count = sizeof fw->posted_us;
		words_copy(record->receiver_bytes, fw->posted_us, sizeof fw->posted_us);
	}
	record->sample = fw->samples - 1u;
	if (fw->rotors.on) {
		words_copy(record->rotors, fw->rotors.words, sizeof record->rotors);
		record->silent_motors = fw->rotors.silent;
		record->weak_motors = fw->weak_motor.weak;
	}
	words_copy((uint8_t *)record + RECORD(observation), fw->control.seen, ANSWER);
	words_copy(record->accel, (const uint8_t *)fw + LAST, MEASURED);
}
