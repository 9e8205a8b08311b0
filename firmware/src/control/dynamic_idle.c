#include "control/dynamic_idle.h"

#include "common/limit.h"
#include "common/nf_math.h"

/* Output for a rad/s that lacks: at once, and more in each second. Of the twins the NF1's rotors give most for an output, 4,100
 * rad/s, the Iris' least, 1,100: a third of what lacks is given at once there, and the rest within 0.1 s or 0.4 s. */
#define AT_ONCE 8e-5f
#define A_SECOND 2.4e-3f

void dynamic_idle_init(struct dynamic_idle *idle, const struct nf_settings *settings, unsigned control_rate_hz)
{
	*idle = (struct dynamic_idle){
		.wanted = settings->motor_telemetry ? (float)settings->dynamic_idle_rpm * (NF_PI / 30.0f) : 0.0f,
		.period_s = 1.0f / (float)control_rate_hz,
	};
}

void dynamic_idle_reset(struct dynamic_idle *idle)
{
	idle->sum = 0.0f;
}

float dynamic_idle_step(struct dynamic_idle *idle, const float speed[POLICY_ACTION_COUNT], uint32_t silent)
{
	if (!(idle->wanted > 0.0f))
		return 0.0f;
	float slowest = speed[0];
	for (int i = 1; i < POLICY_ACTION_COUNT; ++i)
		slowest = speed[i] < slowest ? speed[i] : slowest;
	/* Silence counts as if all were twice as fast as they are to be. */
	const float lack = silent ? -idle->wanted : limit(idle->wanted - slowest, -idle->wanted, idle->wanted);

	idle->sum = limit(idle->sum + A_SECOND * idle->period_s * lack, 0.0f, NF_DYNAMIC_IDLE_MAX);
	return limit(idle->sum + AT_ONCE * (lack > 0.0f ? lack : 0.0f), 0.0f, NF_DYNAMIC_IDLE_MAX);
}
