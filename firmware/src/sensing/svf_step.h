/* Steps of a section of svf.h, inlined: the filters between two gyro samples run dozens of them. */
#pragma once

#include "sensing/svf.h"

/* damping: 1 / Q. */
static inline struct svf svf_at(float gain, float damping)
{
	return (struct svf){ gain, 1.0f / (1.0f + gain * (gain + damping)) };
}

/* One sample through the section. Returns its band-pass, Q high at its frequency. */
static inline float svf_step(const struct svf *svf, struct svf_memory *memory, float in)
{
	const float band = __builtin_fmaf(svf->gain * svf->scale, in - memory->low, svf->scale * memory->band);

	memory->band = __builtin_fmaf(2.0f, band, -memory->band);
	memory->low = __builtin_fmaf(2.0f * svf->gain, band, memory->low);
	return band;
}

/* One sample through the section as a low-pass, and as a notch of the same damping. */
static inline float svf_low_pass(const struct svf *svf, struct svf_memory *memory, float in)
{
	const float low = memory->low;

	return __builtin_fmaf(svf->gain, svf_step(svf, memory, in), low);
}

static inline float svf_notch(const struct svf *svf, float damping, struct svf_memory *memory, float in)
{
	return __builtin_fmaf(-damping, svf_step(svf, memory, in), in);
}
