#include "control/pid.h"

#include "common/limit.h"

void pid_init(struct pid *pid, const struct pid_gains *gains, const struct nf_settings *settings)
{
	const float factors[3][3] = {
		{ settings->pid_roll_p, settings->pid_roll_i, settings->pid_roll_d },
		{ settings->pid_pitch_p, settings->pid_pitch_i, settings->pid_pitch_d },
		{ settings->pid_yaw_p, settings->pid_yaw_i, settings->pid_yaw_d },
	};

	*pid = (struct pid){ .gains = gains, .compensation = 1.0f };
	for (int i = 0; i < 3; ++i) {
		pid->p[i] = factors[i][0] * gains->p[i];
		pid->i[i] = factors[i][1] * gains->i[i];
		pid->d[i] = factors[i][2] * gains->d[i];
		/* A factor of I changes how fast the integral acts, not the largest output that it may reach. */
		pid->integral_max[i] = factors[i][1] > 0.0f ? gains->integral_max[i] / factors[i][1] : 0.0f;
	}
	pid_reset(pid);
}

void pid_reset(struct pid *pid)
{
	pid->first = true;
	for (int i = 0; i < 3; ++i) {
		pid->integral[i] = 0.0f;
		pid->slope[i] = 0.0f;
		pid->rate[i] = 0.0f;
	}
}

float pid_compensation(const struct pid_gains *gains, float voltage)
{
	const float nominal = gains->nominal_voltage;
	const float ratio = nominal > 0.0f && voltage > 0.0f ? nominal / voltage : 1.0f;

	return limit(ratio * ratio, 1.0f, NF_PID_COMPENSATION_MAX);
}

/* Returns the factor of D for the throttle: exactly 1 up to the breakpoint. P and I are not reduced, because they hold the
 * axis and amplify little noise. */
static float pid_attenuation(const struct pid_gains *gains, float throttle)
{
	const float above = throttle - gains->tpa_breakpoint;

	return above > 0.0f ? 1.0f - gains->tpa_slope * above : 1.0f;
}

/* Demand of an axis to a motor whose share in it is 1. attenuation: of D. */
static float pid_axis_step(struct pid *pid, int i, float setpoint, float rate, float attenuation)
{
	const struct pid_gains *g = pid->gains;
	const float error = setpoint - rate;
	const float slope = pid->first ? 0.0f : (rate - pid->rate[i]) / g->period_s;

	pid->slope[i] += g->smoothing * (slope - pid->slope[i]);
	pid->rate[i] = rate;
	const float gathered = pid->standing ? 0.0f : error * g->period_s;
	pid->integral[i] = limit(pid->integral[i] + gathered, -pid->integral_max[i], pid->integral_max[i]);
	return pid->p[i] * error + pid->i[i] * pid->integral[i] - attenuation * pid->d[i] * pid->slope[i];
}

/* Moves demands into 0..1: scaled where they span more than 1, raised until none is below 0, clipped at 1. */
static void pid_desaturate(float demand[POLICY_ACTION_COUNT])
{
	float lowest = demand[0], highest = demand[0];

	for (int i = 1; i < POLICY_ACTION_COUNT; ++i) {
		lowest = demand[i] < lowest ? demand[i] : lowest;
		highest = demand[i] > highest ? demand[i] : highest;
	}
	const float span = highest - lowest > 1.0f ? highest - lowest : 1.0f;
	const float lift = lowest < 0.0f ? -lowest : 0.0f;
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		demand[i] = limit((demand[i] + lift) / span, 0.0f, 1.0f);
}

void pid_step(struct pid *pid, const float setpoint[3], const float rate[3], float throttle,
	      float action[POLICY_ACTION_COUNT])
{
	const float attenuation = pid_attenuation(pid->gains, throttle);
	const float compensation = pid->compensation;
	float axes[3];

	for (int i = 0; i < 3; ++i)
		axes[i] = compensation * pid_axis_step(pid, i, setpoint[i], rate[i], attenuation);
	pid->first = false;
	for (int m = 0; m < POLICY_ACTION_COUNT; ++m) {
		const float *share = pid->gains->mixer[m];
		action[m] = share[0] * axes[0] + share[1] * axes[1] + share[2] * axes[2];
	}
	pid_desaturate(action);
}
