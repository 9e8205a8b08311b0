/* What the blackbox keeps of one control step: all that the control path was given, and what came of it. The gyro's
 * interrupt copies it; the background makes frames of it. */
#ifndef NF_LOG_RECORD_H
#define NF_LOG_RECORD_H

#include <stdint.h>

#include "common/status.h"
#include "nf_contract.h"
#include "policy.h"

#define LOG_SUBSAMPLES_MAX (NF_GYRO_EDGE_RATE_HZ / POLICY_CONTROL_RATE_HZ) /* gyro samples a control step */

/* Bits of struct log_record's edge_flags. */
enum log_edge {
	LOG_EDGE_POSTED = 1u << 0,       /* receiver bytes are 16 channels [us], little-endian, that MSP posted */
	LOG_EDGE_ACKNOWLEDGED = 1u << 1, /* firmware_acknowledge */
	LOG_EDGE_CALIBRATE = 1u << 2,    /* firmware_calibrate */
	LOG_EDGE_WEIGHTS_BAD = 1u << 3,  /* firmware_weights: false */
	LOG_EDGE_WEIGHTS_GOOD = 1u << 4, /* firmware_weights: true, since the last step */
	LOG_EDGE_MISSED = 1u << 5,       /* this step missed its deadline: firmware_deadline */
	LOG_EDGE_SILENT = 1u << 6,       /* firmware_gyro_silent was called before this step */
	LOG_EDGE_MORE_BYTES = 1u << 7,   /* more receiver bytes came than fit: cannot be replayed */
	LOG_EDGE_BENCH = 1u << 8,        /* a motor test or DShot command was under way: cannot be replayed */
};

struct log_record {
	struct control_trace trace;
	uint32_t sample;        /* gyro samples since boot when the step began */
	uint32_t cycles;        /* that the step took */
	uint32_t forbidden;     /* arming reasons of the background, as taken by this step */
	float voltage_gain;     /* of the PID, as taken by this step */
	uint16_t edge_flags;    /* enum log_edge */
	uint16_t lost;          /* gyro samples lost since the last control step */
	uint8_t samples;        /* gyro samples since the last control step, this step's included */
	uint8_t invalid;        /* bit i: sample i was not valid */
	uint8_t repeated;       /* bit i: sample i repeated the one before in every word */
	uint8_t receiver_count; /* bytes handed to firmware_receive */
	uint8_t state;          /* enum nf_flight_state */
	uint8_t stop_cause, fallback_cause, modes;
	uint8_t pid_flies, receiver_good, receiver_quality, gyro_health;
	int16_t counts[LOG_SUBSAMPLES_MAX][3]; /* gyro, chip axes, oldest first */
	int16_t accel[3];       /* counts of the last good sample, chip axes */
	int16_t temperature;
	float observation[POLICY_OBSERVATION_COUNT]; /* what the policy was given last */
	float action[POLICY_ACTION_COUNT];
	uint8_t receiver_bytes[NF_LOG_RECEIVER_BYTES];
};

#endif
