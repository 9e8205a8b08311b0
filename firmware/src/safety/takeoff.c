#include "safety/takeoff.h"

#include "common/nf_math.h"

#define TURN (NF_TAKEOFF_TURN_DEG * NF_RAD_PER_DEG)

void takeoff_init(struct takeoff *takeoff, const struct nf_settings *settings, unsigned control_rate_hz)
{
	const float forgotten = nf_one_minus_exp(1000.0f / (float)(control_rate_hz * NF_TAKEOFF_FORGETS_MS));

	*takeoff = (struct takeoff){
		.raised_after = settings->ground_detection ? control_rate_hz * NF_TAKEOFF_MS / 1000u : 0,
		.period_s = 1.0f / (float)control_rate_hz,
		.kept = 1.0f - forgotten,
	};
}

void takeoff_reset(struct takeoff *takeoff)
{
	takeoff->airborne = false;
	takeoff->raised = 0;
	for (int i = 0; i < 3; ++i)
		takeoff->turned[i] = 0.0f;
}

void takeoff_step(struct takeoff *takeoff, const float rate[3], float throttle)
{
	takeoff->raised = throttle > NF_TAKEOFF_THROTTLE ? takeoff->raised + 1u : 0u;
	bool airborne = takeoff->raised >= takeoff->raised_after;

	for (int i = 0; i < 3; ++i) {
		const float turned = takeoff->kept * (takeoff->turned[i] + rate[i] * takeoff->period_s);
		takeoff->turned[i] = turned;
		airborne |= turned > TURN || turned < -TURN;
	}
	takeoff->airborne = airborne;
}
