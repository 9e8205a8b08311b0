/* Attitude from gyro and accelerometer: for telemetry and for the tilt limit of arming; the control law does not use
 * it. Explicit complementary filter: Mahony, Hamel, Pflimlin, "Nonlinear Complementary Filters on the Special
 * Orthogonal Group", IEEE Transactions on Automatic Control 53 (2008), eq. 48. The heading is not measured: it starts
 * at 0 and drifts. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

struct attitude {
	float q[4];          /* unit quaternion w, x, y, z, body to world */
	float bias[3];       /* rad/s, body axes: what is added to the gyro */
	float period;        /* s, of a step */
	uint32_t settling;   /* steps with a usable accelerometer until the attitude is known */
	bool begun;          /* q came from an accelerometer */
};

/* Starts level and unknown. rate_hz: of the steps. */
void attitude_init(struct attitude *attitude, unsigned rate_hz);

/* One control step. rate: body axes [rad/s]; acceleration: specific force, body axes [m/s^2], used where it is 0.85 to
 * 1.15 g long. The first one used sets the attitude, those of the first second correct it quickly. */
void attitude_step(struct attitude *attitude, const float rate[3], const float acceleration[3]);

/* Has the accelerometer been usable for a second in total? */
bool attitude_known(const struct attitude *attitude);

/* Where up is, body axes, of length 1. */
void attitude_up(const struct attitude *attitude, float up[3]);

/* Roll (right +, -180 to 180), pitch (nose down +, -90 to 90), yaw (left +, -180 to 180) [deg]: turned first by
 * yaw, then by pitch, then by roll. */
void attitude_euler_deg(const struct attitude *attitude, float angles[3]);
