#include "sensing/svf.h"

struct outputs {
	float band; /* Q high at the section's frequency */
	float low;
};

static inline struct outputs step(const struct section *section, struct section_memory *memory, float in)
{
	const float band = section->scale * (memory->band + section->gain * (in - memory->low));
	const float low = memory->low + section->gain * band;

	memory->band = 2.0f * band - memory->band;
	memory->low = 2.0f * low - memory->low;
	return (struct outputs){ band, low };
}

struct section section_at(float gain, float damping)
{
	return (struct section){ gain, 1.0f / (1.0f + gain * (gain + damping)) };
}

float section_low_pass(const struct section *section, struct section_memory *memory, float in)
{
	return step(section, memory, in).low;
}

float section_notch(const struct section *section, float damping, struct section_memory *memory, float in)
{
	return in - damping * step(section, memory, in).band;
}
