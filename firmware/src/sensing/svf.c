#include "sensing/svf.h"

struct outputs {
	float band; /* Q high at the section's frequency */
	float low;
};

static inline struct outputs svf_step(const struct svf *svf, struct svf_memory *memory, float in)
{
	const float band = svf->scale * (memory->band + svf->gain * (in - memory->low));
	const float low = memory->low + svf->gain * band;

	memory->band = 2.0f * band - memory->band;
	memory->low = 2.0f * low - memory->low;
	return (struct outputs){ band, low };
}

struct svf svf_at(float gain, float damping)
{
	return (struct svf){ gain, 1.0f / (1.0f + gain * (gain + damping)) };
}

float svf_low_pass(const struct svf *svf, struct svf_memory *memory, float in)
{
	return svf_step(svf, memory, in).low;
}

float svf_notch(const struct svf *svf, float damping, struct svf_memory *memory, float in)
{
	return in - damping * svf_step(svf, memory, in).band;
}
