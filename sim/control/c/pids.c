/* The firmware's PID, once for each of many aircraft. */
#include "api.h"

#include "control/pid.h"

struct pids {
	size_t count;
	struct pid each[];
};

size_t pids_size(size_t count)
{
	return sizeof(struct pids) + count * sizeof(struct pid);
}

void pids_init(struct pids *pids, size_t count, const struct pid_gains *gains, size_t gains_count, bool standing)
{
	static const struct nf_settings usual = {
		.pid_roll_p = 1.0f, .pid_roll_i = 1.0f, .pid_roll_d = 1.0f,
		.pid_pitch_p = 1.0f, .pid_pitch_i = 1.0f, .pid_pitch_d = 1.0f,
		.pid_yaw_p = 1.0f, .pid_yaw_i = 1.0f, .pid_yaw_d = 1.0f,
	};

	pids->count = count;
	for (size_t i = 0; i < count; ++i) {
		pid_init(&pids->each[i], &gains[i % gains_count], &usual);
		pids->each[i].standing = standing;
	}
}

void pids_reset(struct pids *pids)
{
	for (size_t i = 0; i < pids->count; ++i)
		pid_reset(&pids->each[i]);
}

void pids_compensate(struct pids *pids, const float volts[])
{
	for (size_t i = 0; i < pids->count; ++i)
		pids->each[i].compensation = pid_compensation(pids->each[i].gains, volts[i]);
}

void pids_step(struct pids *pids, const float setpoint[], const float rate[], const float throttle[], float action[])
{
	for (size_t i = 0; i < pids->count; ++i)
		pid_step(&pids->each[i], &setpoint[3 * i], &rate[3 * i], throttle[i], &action[POLICY_ACTION_COUNT * i]);
}
