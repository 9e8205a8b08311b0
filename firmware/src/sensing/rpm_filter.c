#include "sensing/rpm_filter.h"

#include <string.h>

#include "common/limit.h"
#include "common/nf_math.h"
#include "sensing/svf_step.h"

void rpm_filter_init(struct rpm_filter *filter, const struct nf_settings *settings, unsigned gyro_rate_hz)
{
	const float rate_hz = (float)gyro_rate_hz, least = settings->rpm_filter_min_hz / rate_hz;

	memset(filter, 0, sizeof *filter);
	filter->harmonics = settings->motor_telemetry ? (uint8_t)settings->rpm_filter_harmonics : 0;
	filter->damping = 1.0f / settings->rpm_filter_q;
	filter->turns = 1.0f / (NF_TAU * rate_hz);
	filter->least = least;
	filter->fade = rate_hz / NF_RPM_FILTER_FADE_HZ;
	filter->least_gain = nf_sin_turns(0.5f * least) / nf_cos_turns(0.5f * least);
	for (int motor = 0; motor < POLICY_ACTION_COUNT; ++motor)
		for (int i = 0; i < RPM_HARMONICS_MAX; ++i)
			filter->notch[motor][i].svf = svf_at(filter->least_gain, filter->damping);
}

/* A notch whose centre is beyond its limits stays where it is, and takes nothing out. */
static inline void rpm_filter_place(const struct rpm_filter *filter, struct rpm_notch *notch, float turns, float gain)
{
	const float part = (turns - filter->least) * filter->fade;

	notch->depth = 0.0f;
	if (!(part > 0.0f && turns < NF_RPM_FILTER_HIGHEST))
		return;
	notch->svf = svf_at(gain, filter->damping);
	notch->depth = filter->damping * (part < 1.0f ? part : 1.0f);
}

/* The tangents of the multiples follow from that of the first by addition. */
static __attribute__((noinline)) void rpm_filter_move(struct rpm_filter *filter, const struct rotors *rotors,
						      unsigned motor)
{
	const bool silent = (rotors->silent >> motor & 1u) != 0;
	const float turns = silent ? 0.0f : limit(rotors->speed[motor] * filter->turns, 0.0f, NF_RPM_FILTER_HIGHEST);
	const float first = nf_sin_turns(0.5f * turns) / nf_cos_turns(0.5f * turns);
	float multiple = turns, gain = first;

	for (unsigned i = 0; i < filter->harmonics; ++i) {
		rpm_filter_place(filter, &filter->notch[motor][i], multiple, gain);
		multiple += turns;
		gain = (gain + first) / (1.0f - gain * first);
	}
}

void rpm_filter_step(struct rpm_filter *filter, const struct rotors *rotors, float rate[3])
{
	if (filter->harmonics == 0)
		return;
	rpm_filter_move(filter, rotors, filter->next);
	filter->next = (uint8_t)(filter->next + 1u == POLICY_ACTION_COUNT ? 0u : filter->next + 1u);
	float x = rate[0], y = rate[1], z = rate[2];
	const unsigned harmonics = filter->harmonics;

	for (unsigned motor = 0; motor < POLICY_ACTION_COUNT; ++motor) {
		struct rpm_notch *notch = filter->notch[motor];

		for (unsigned left = harmonics; left > 0; --left, ++notch) {
			const struct svf svf = notch->svf;
			const float depth = notch->depth;
			x = svf_notch(&svf, depth, &notch->memory[0], x);
			y = svf_notch(&svf, depth, &notch->memory[1], y);
			z = svf_notch(&svf, depth, &notch->memory[2], z);
		}
	}
	rate[0] = x;
	rate[1] = y;
	rate[2] = z;
}
