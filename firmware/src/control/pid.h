/* PID: the classical controller that stands beside the policy, with the aircraft's gains built in.
 *
 * y = mixer (P e + I sum(e) dt - D d rate/dt), lifted and narrowed into 0..1 so that differences survive. The
 * integral is clamped, the derivative is that of the rate through a first-order low-pass. The same law as
 * sim/control/pid.py. */
#ifndef NF_PID_H
#define NF_PID_H

#include <stdbool.h>
#include <stdint.h>

#include "policy.h"

/* What the build knows of the aircraft; generated. Gains are motor fractions for one rad/s, rad, rad/s^2. */
struct pid_gains {
	uint32_t motor_count;      /* POLICY_ACTION_COUNT; 0: no PID is built in */
	float idle;                /* motor fraction at zero thrust, which the gains were found with */
	float p[3], i[3], d[3];    /* roll, pitch, yaw */
	float integral_max[3];     /* rad */
	float period_s;            /* of a control step */
	float smoothing;           /* part of a new derivative that its low-pass takes over in a step, (0, 1] */
	float mixer[POLICY_ACTION_COUNT][3]; /* share of each motor in roll, pitch, yaw */
};

/* The generated one. */
extern const struct pid_gains pid_gains_built_in;

struct pid {
	const struct pid_gains *gains;
	bool first;                /* no step since the reset: there is no derivative yet */
	float integral[3];         /* rad */
	float rate[3];             /* rad/s, of the last step */
	float slope[3];            /* rad/s^2, low-passed */
};

/* `gains` must outlive the PID. */
void pid_init(struct pid *pid, const struct pid_gains *gains);

/* Forgets the past. */
void pid_reset(struct pid *pid);

/* One control step. setpoint, rate: rad/s, body axes. Writes motor fractions 0..1, before the throttle. */
void pid_step(struct pid *pid, const float setpoint[3], const float rate[3], float action[POLICY_ACTION_COUNT]);

#endif
