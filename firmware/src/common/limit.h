/* Clamping by comparison: the same bits on every target, and no NaN comes through. */
#ifndef NF_LIMIT_H
#define NF_LIMIT_H

/* `value` within [low, high]; `low` for NaN. */
static inline float limit(float value, float low, float high)
{
	const float raised = value > low ? value : low;

	return raised < high ? raised : high;
}

#endif
