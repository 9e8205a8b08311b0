#include "safety/crash.h"

#include "common/limit.h"
#include "common/nf_math.h"

#define ERROR_LIMIT (NF_CRASH_ERROR_DEG_S * NF_RAD_PER_DEG)

void crash_init(struct crash *crash, const struct nf_settings *settings, unsigned control_rate_hz)
{
	*crash = (struct crash){
		.crash_after = settings->crash_detection ? control_rate_hz * NF_CRASH_MS / 1000u : 0,
		.runaway_after = settings->runaway_detection ? control_rate_hz * NF_RUNAWAY_MS / 1000u : 0,
		.window = control_rate_hz * NF_RUNAWAY_WINDOW_MS / 1000u,
	};
}

void crash_reset(struct crash *crash)
{
	crash->flown = 0;
	crash->helpless = 0;
	crash->away = 0;
}

void crash_relieve(struct crash *crash)
{
	crash->helpless = 0;
	crash->away = 0;
}

bool crash_watches(const struct crash *crash)
{
	return crash->crash_after > 0;
}

static int crash_furthest(const float setpoint[3], const float rate[3])
{
	int axis = 0;

	for (int i = 1; i < 3; ++i)
		if (magnitude(setpoint[i] - rate[i]) > magnitude(setpoint[axis] - rate[axis]))
			axis = i;
	return axis;
}

static bool crash_lasts(uint32_t steps, uint32_t limit)
{
	return limit > 0 && steps >= limit;
}

/* Counts steps in which the large error of `axis`, the largest, grows: now of one axis, now of another where an aircraft
 * turns about a diagonal. Returns whether that is a runaway. */
static bool crash_runs_away(struct crash *crash, const struct crash_input *input, int axis, float error)
{
	const float rate = input->rate[axis], size = magnitude(rate);

	if (rate * error >= 0.0f || turning_towards(input->turning, axis, error) ||
	    (crash->away > 0 && size <= crash->first_rate)) {
		crash->away = 0;
		return false;
	}
	if (crash->away++ == 0)
		crash->first_rate = size;
	return crash->flown < crash->window && crash_lasts(crash->away, crash->runaway_after);
}

/* Does the controller act on the large error of `axis` in vain? */
static bool crash_helpless(const struct crash_input *input, int axis, float error)
{
	return input->airborne && input->spread >= NF_CRASH_SPREAD && !turning_towards(input->turning, axis, error) &&
	       !turning_at_limit(input->rate[axis], error);
}

enum crash_verdict crash_step(struct crash *crash, const struct crash_input *input)
{
	const int axis = crash_furthest(input->setpoint, input->rate);
	const float error = input->setpoint[axis] - input->rate[axis];

	if ((input->thrust || crash->flown > 0) && crash->flown < crash->window)
		++crash->flown;
	if (!(magnitude(error) > ERROR_LIMIT)) {
		crash->helpless = 0;
		crash->away = 0;
		return CRASH_NONE;
	}
	crash->helpless = crash_helpless(input, axis, error) ? crash->helpless + 1u : 0u;
	if (crash_runs_away(crash, input, axis, error))
		return CRASH_RUNAWAY;
	return crash_lasts(crash->helpless, crash->crash_after) ? CRASH_HAPPENED : CRASH_NONE;
}
