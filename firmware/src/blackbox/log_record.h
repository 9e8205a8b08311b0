/* What the blackbox keeps of one control step: all that the control path was given, and what came of it. The gyro's
 * interrupt copies it; the background makes frames of it.
 *
 * The order is that of the copying (firmware_log, runtime.c): neighbours here are neighbours there. */
#pragma once

#include "common/status.h"
#include "control/chirp.h"
#include "nf_contract.h"
#include "policy.h"

#define LOG_SUBSAMPLES_MAX (NF_GYRO_EDGE_RATE_HZ / POLICY_CONTROL_RATE_HZ) /* gyro samples a control step */
#define LOG_STICKS 4 /* roll, pitch, throttle, yaw: the first channels of the contract's order */

struct log_record {
	struct control_trace trace;
	uint32_t arming_reasons; /* bit field of enum nf_arming_reason, 0 when armed */
	uint16_t sticks_us[LOG_STICKS]; /* as flown */
	/* As in struct firmware_status, in its order. */
	uint8_t modes;
	uint8_t receiver_good, policy_good, pid_built_in, pid_flies;
	uint8_t state, stop_cause, fallback_cause, refused_cause;
	uint8_t gyro_health, receiver_quality, attitude_known;
	float attitude[4]; /* unit quaternion w, x, y, z, body to world */
	struct chirp_sweep chirp;
	/* The edges, as taken by this step: struct firmware_edges. */
	uint32_t forbidden; /* arming reasons of the background */
	float voltage_gain; /* of the PID */
	uint32_t edge_flags; /* enum log_edge */
	uint32_t sample; /* gyro samples since boot when the step began */
	uint32_t cycles; /* that the step took */
	uint32_t lost; /* gyro samples lost since the last control step */
	uint16_t rotors[NF_MOTOR_COUNT_MAX]; /* words of the ESCs, by output; only where motor_telemetry is on */
	uint8_t silent_motors, weak_motors; /* bit fields, likewise */
	uint16_t reserved;
	float observation[POLICY_OBSERVATION_COUNT]; /* what the policy was given last */
	float action[POLICY_ACTION_COUNT]; /* the controller's last answer, before the throttle */
	int16_t accel[3]; /* counts of the last good sample, chip axes */
	int16_t temperature;
	struct log_sample gyro[LOG_SUBSAMPLES_MAX]; /* since the last control step, oldest first */
	uint16_t samples; /* entries of it; the last one is this step's */
	uint16_t receiver_count; /* bytes handed to firmware_receive */
	uint8_t receiver_bytes[NF_LOG_RECEIVER_BYTES];
};
