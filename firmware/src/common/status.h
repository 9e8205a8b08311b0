/* The firmware's state for others: the trace of a control step and the status that MSP reports. */
#pragma once

#include "nf_contract.h"

/* One control step as the controller saw it. */
struct control_trace {
	uint32_t step;                         /* control steps since boot, the first is 0 */
	float setpoint[3];                     /* rad/s, body axes */
	float gyro[3];                         /* rad/s, body axes, bias removed: what the policy used */
	float throttle;                        /* 0..1 */
	uint8_t armed;                         /* 1: the motors obey, 0: stopped */
	uint8_t motor_count;                   /* used entries of dshot */
	uint16_t dshot[NF_MOTOR_COUNT_MAX];    /* 11-bit values, motor order; 0 stops */
};

/* All data of one control step that a stream sends. */
struct control_record {
	struct control_trace trace;
	uint32_t cycles;                       /* that the step took */
	uint8_t state;                         /* enum nf_flight_state */
	bool pid_flies;
	uint8_t observation_count;             /* 0: the policy was not asked */
	uint8_t action_count;                  /* 0: no controller was */
	float observation[NF_OBSERVATION_COUNT_MAX];
	float action[NF_MOTOR_COUNT_MAX];      /* the controller's answer, before the throttle */
};

/* A consistent snapshot of the firmware after its last control step. */
struct firmware_status {
	struct control_trace trace;
	uint32_t arming_reasons;               /* bit field of enum nf_arming_reason, 0 when armed */
	uint16_t channels_us[NF_CHANNEL_COUNT];/* as flown: failsafe values while the receiver is lost */
	uint16_t gyro_rate_hz;
	uint16_t load_percent; /* longest gyro sample so far, of its period, with a controller; background.c */
	uint8_t modes; /* bit field of enum mode_index: those that are on; 0: receiver lost */
	bool receiver_good; /* a frame came within the hold time */
	bool policy_good; /* self-test passed and no output was refused since */
	bool pid_built_in; /* there is a PID to fall back on */
	bool pid_flies; /* it flies, or would if armed now */
	uint8_t state; /* enum nf_flight_state */
	uint8_t stop_cause; /* enum nf_stop_cause: why the motors stopped last */
	uint8_t fallback_cause; /* enum nf_fallback_cause: why the PID took over last */
	uint8_t refused_cause; /* enum nf_fallback_cause: why the policy must not fly, NONE: it may */
	uint8_t gyro_health; /* enum nf_gyro_health */
	uint8_t receiver_quality; /* % */
	bool attitude_known;
	bool airborne; /* it has taken off since it was armed */
	float attitude_deg[3]; /* roll, pitch, yaw as attitude_euler_deg tells; 0 until known */
	float accel_g[3]; /* body axes */
	float temperature_deg_c; /* of the gyro */
	float idle; /* motor fraction at zero thrust, of the controller that flies */
	/* Filled in by background.c. */
	float volts, amps; /* of the battery, filtered */
	float drawn_mah;
	float sag_v; /* voltage drop by the load */
	uint8_t cells; /* 0: not known */
	uint8_t battery_level; /* enum battery_level */
	uint8_t gyro_identity; /* what the gyro chip says it is, known or not; 0: nothing was read */
	uint8_t gyro_chip; /* enum gyro_chip + 1; 0: none that is known */
	uint32_t motor_key; /* what motors_checked must be if they have been checked as they are */
	uint8_t brown_out; /* the detector's level + 1, 1: it is off; 0: not told */
};
