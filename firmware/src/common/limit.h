/* Clamping by comparison: the same bits on every target, and no NaN comes through. */
#pragma once

/* `value` without its sign. */
static inline float magnitude(float value)
{
	return value < 0.0f ? -value : value;
}

/* `value` within [low, high]; `low` for NaN. */
static inline float limit(float value, float low, float high)
{
	const float raised = value > low ? value : low;

	return raised < high ? raised : high;
}
