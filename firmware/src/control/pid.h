/* PID: the classical controller that stands beside the policy, with the aircraft's gains built in.
 *
 * y = mixer c (P e + I sum(e) dt - a D d rate/dt), lifted and narrowed into 0..1 so that differences survive. The
 * integral is clamped, the derivative is that of the rate through a first-order low-pass. a, the throttle's attenuation,
 * falls from 1 above a throttle; c, the battery's compensation, rises from 1 as the pack sags. The twin's PIDs are this
 * C too: sim/control/library.py. */
#ifndef NF_PID_H
#define NF_PID_H

#include <stdbool.h>
#include <stdint.h>

#include "common/held.h"
#include "nf_contract.h"
#include "policy.h"

/* What the build knows of the aircraft; generated. Gains are motor fractions for one rad/s, rad, rad/s^2. */
struct pid_gains {
	uint32_t motor_count;      /* POLICY_ACTION_COUNT; 0: no PID is built in */
	float idle;                /* motor fraction at zero thrust, which the gains were found with */
	float p[3], i[3], d[3];    /* roll, pitch, yaw */
	float integral_max[3];     /* rad */
	float period_s;            /* of a control step */
	float smoothing;           /* part of a new derivative that its low-pass takes over in a step, (0, 1] */
	float tpa_breakpoint;      /* throttle above which D falls, 0..1 */
	float tpa_slope;           /* by how much of it a unit of throttle; 0: it stays */
	enum nf_mix mix;           /* of its outputs with the pilot's thrust */
	float nominal_voltage;     /* of the pack that the gains were found with [V]; 0: another is not compensated */
	float mixer[POLICY_ACTION_COUNT][3]; /* share of each motor in roll, pitch, yaw */
};

/* The generated one. */
extern const struct pid_gains pid_gains_built_in;

struct pid {
	HELD(const struct pid_gains *, gains);
	float p[3], i[3], d[3];    /* the gains times the pilot's factors */
	float integral_max[3];     /* rad; 0 where there is no I */
	float compensation;        /* of the pack's voltage, 1 to NF_PID_COMPENSATION_MAX: as pid_compensation says */
	bool standing;             /* on the ground: the integral does not grow */
	bool first;                /* no step since the reset: there is no derivative yet */
	float integral[3];         /* rad */
	float rate[3];             /* rad/s, of the last step */
	float slope[3];            /* rad/s^2, low-passed */
};

/* `gains` must outlive the PID; `settings`: within their limits, its factors are copied. */
void pid_init(struct pid *pid, const struct pid_gains *gains, const struct nf_settings *settings);

/* Forgets the past; the battery's voltage stays, and the ground. */
void pid_reset(struct pid *pid);

/* The compensation for the pack's voltage, filtered [V]; 0 or NaN where it is not known: none.
 *
 * A rotor settles at a speed that goes with the voltage, its thrust with the square of the speed: the moment that an
 * output gives goes with the square of the voltage. Outputs are multiplied by (nominal / voltage)^2, at least 1, so that
 * a fuller pack than the nominal one flies the gains as they are, and at most NF_PID_COMPENSATION_MAX. */
float pid_compensation(const struct pid_gains *gains, float voltage);

/* One control step. setpoint, rate: rad/s, body axes; throttle: 0..1. Writes motor fractions 0..1, before the
 * throttle. */
void pid_step(struct pid *pid, const float setpoint[3], const float rate[3], float throttle,
	      float action[POLICY_ACTION_COUNT]);

#endif
