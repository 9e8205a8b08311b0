#include "control/observation.h"

#include <string.h>

#include "common/limit.h"

/* Where the values of each block lie in a step: one function for each of the contract's blocks that this core has a source
 * for; one without it does not compile. */
#define SOURCE(name, values)                                                                      \
	static inline const float *observation_find_##name(const struct observation *o,           \
							   const struct observation_input *input) \
	{                                                                                         \
		(void)o;                                                                          \
		(void)input;                                                                      \
		return values;                                                                    \
	}
SOURCE(rate, input->rate)
SOURCE(rate_error, o->error)
SOURCE(rate_error_delta, o->delta)
SOURCE(rate_error_integral, o->integral)
SOURCE(previous_action, input->previous_action)
SOURCE(throttle, &input->throttle)
SOURCE(rotor_speed, input->rotor_speed)
SOURCE(previous_motors, input->previous_motors)
SOURCE(rotor_estimate, input->rotor_estimate)
SOURCE(rate_estimate, input->rate_estimate)
SOURCE(rate_estimate_error, input->rate_estimate_error)
SOURCE(rotor_measured, input->rotor_estimate)

/* Sources of the blocks, indexed by block code. */
static const struct block {
	bool known;
	unsigned char width; /* 0: one value a motor */
} table[] = {
#define ROW(name, code, width) [code] = { true, width },
	NF_OBSERVATION_BLOCKS(ROW)
#undef ROW
};

/* The block's values, 0 for a code that is none. */
static size_t observation_block_width(unsigned char code, size_t motor_count)
{
	if (code >= sizeof table / sizeof table[0] || !table[code].known)
		return 0;
	return table[code].width ? table[code].width : motor_count;
}

enum nf_err observation_init(struct observation *o, const struct observation_terms *terms, size_t motor_count,
			     size_t width, unsigned control_rate_hz)
{
	size_t sum = 0, remembered = 0;

	if (terms->count > NF_OBSERVATION_TERMS_MAX)
		return NF_ERR_OBSERVATION;
	for (size_t i = 0; i < terms->count; ++i) {
		const size_t values = observation_block_width(terms->blocks[i], motor_count);
		if (values == 0 || terms->ages[i] > NF_OBSERVATION_AGE_MAX ||
		    !(terms->gains[i] >= 0.0f && terms->gains[i] < 1.0f))
			return NF_ERR_OBSERVATION;
		sum += values;
		remembered += values * (terms->ages[i] + (terms->gains[i] > 0.0f ? 1u : 0u));
	}
	if (sum != width || remembered > NF_OBSERVATION_MEMORY_MAX)
		return NF_ERR_OBSERVATION;
	o->blocks = terms->blocks;
	o->ages = terms->ages;
	o->gains = terms->gains;
	o->count = (uint32_t)terms->count;
	o->motor_count = (uint32_t)motor_count;
	o->period_s = 1.0f / (float)control_rate_hz;
	observation_reset(o);
	return NF_OK;
}

void observation_reset(struct observation *o)
{
	o->first = true;
	for (int i = 0; i < 3; ++i) {
		o->error[i] = 0.0f;
		o->delta[i] = 0.0f;
		o->integral[i] = 0.0f;
	}
	memset(o->memory, 0, sizeof o->memory);
	memset(o->turns, 0, sizeof o->turns);
}

bool observation_sees(const struct observation *o, enum nf_observation block)
{
	for (uint32_t i = 0; i < o->count; ++i)
		if (o->blocks[i] == (unsigned char)block)
			return true;
	return false;
}

static void observation_update(struct observation *o, const struct observation_input *input)
{
	const float gathers_s = input->standing ? 0.0f : o->period_s;

	for (int i = 0; i < 3; ++i) {
		const float error = input->setpoint[i] - input->rate[i];
		o->delta[i] = o->first ? 0.0f : error - o->error[i];
		o->integral[i] = limit(o->integral[i] + error * gathers_s, -NF_RATE_ERROR_INTEGRAL_LIMIT_RAD,
				       NF_RATE_ERROR_INTEGRAL_LIMIT_RAD);
		o->error[i] = error;
	}
}

/* Writes values; returns the end of them. */
static inline float *observation_put(const float *values, size_t width, float *out)
{
	for (size_t i = 0; i < width; ++i)
		out[i] = values[i];
	return out + width;
}

/* Writes the low-pass of values, whose state is `state`. */
static inline float *observation_pass(float *state, float gain, bool first, const float *values, size_t width,
				      float *out)
{
	for (size_t i = 0; i < width; ++i) {
		state[i] = first ? values[i] : state[i] + gain * (values[i] - state[i]);
		out[i] = state[i];
	}
	return out + width;
}

/* Exchanges the values from `out` to `end` with the oldest in the delay line. */
static void observation_exchange(float *oldest, float *out, const float *end)
{
	for (; out < end; ++out, ++oldest) {
		const float old = *oldest;
		*oldest = *out;
		*out = old;
	}
}

void observation_step(struct observation *o, const struct observation_input *input, float out[])
{
	const float *sources[sizeof table / sizeof table[0]]; /* set where table says so */
#define ROW(name, code, width) sources[code] = observation_find_##name(o, input);
	NF_OBSERVATION_BLOCKS(ROW)
#undef ROW
	float *memory = o->memory;

	observation_update(o, input);
	for (size_t i = 0; i < o->count; ++i) {
		const unsigned block = o->blocks[i], age = o->ages[i];
		const float gain = o->gains[i];
		const size_t width = table[block].width > 0 ? table[block].width : o->motor_count;
		float *const end = gain > 0.0f ? observation_pass(memory, gain, o->first, sources[block], width, out) :
						 observation_put(sources[block], width, out);

		if (gain > 0.0f)
			memory += width;
		if (age > 0) {
			observation_exchange(memory + o->turns[i] * width, out, end);
			o->turns[i] = (unsigned char)(o->turns[i] + 1u == age ? 0u : o->turns[i] + 1u);
			memory += age * width;
		}
		out = end;
	}
	o->first = false;
}
