#include "crash.h"

#define RAD_PER_DEG 0.017453292519943295f
#define ERROR_LIMIT (NF_CRASH_ERROR_DEG_S * RAD_PER_DEG)

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
	crash->beyond = 0;
}

static float largest(const float error[3])
{
	float most = 0.0f;

	for (int i = 0; i < 3; i++) {
		const float size = error[i] < 0.0f ? -error[i] : error[i];
		most = size > most ? size : most;
	}
	return most;
}

static bool lasts(uint32_t steps, uint32_t limit)
{
	return limit > 0 && steps >= limit;
}

enum crash_verdict crash_step(struct crash *crash, const float error[3], float output)
{
	const float size = largest(error);

	if (crash->flown < crash->window)
		crash->flown++;
	if (!(size > ERROR_LIMIT && output >= NF_CRASH_OUTPUT)) {
		crash->beyond = 0;
		return CRASH_NONE;
	}
	if (crash->beyond++ == 0)
		crash->first_error = size;
	if (lasts(crash->beyond, crash->crash_after))
		return CRASH_HAPPENED;
	if (crash->flown < crash->window && lasts(crash->beyond, crash->runaway_after) && size > crash->first_error)
		return CRASH_RUNAWAY;
	return CRASH_NONE;
}
