/* What the firmware tells about itself: the trace of a control step and the snapshot behind MSP. */
#ifndef NF_STATUS_H
#define NF_STATUS_H

#include <stdbool.h>
#include <stdint.h>

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

/* A consistent picture of the firmware after its last control step. */
struct firmware_status {
	struct control_trace trace;
	uint32_t arming_reasons;               /* bit field of enum nf_arming_reason, 0 when armed */
	uint16_t channels_us[NF_CHANNEL_COUNT];/* as flown: failsafe values while the receiver is lost */
	uint16_t gyro_rate_hz;
	uint16_t load_percent;                 /* longest gyro sample so far against the gyro period; main.c's */
	bool receiver_good;                    /* a frame came within the hold time */
	bool policy_good;                      /* self-test passed and no output was refused since */
};

#endif
