#include "observation.h"

#include "limit.h"

/* Each writes one block and returns the end of it. */
typedef float *block_writer(const struct observation *o, const struct observation_input *input, float *out);

static float *put(const float *values, size_t count, float *out)
{
	for (size_t i = 0; i < count; i++)
		*out++ = values[i];
	return out;
}

static float *write_rate(const struct observation *o, const struct observation_input *input, float *out)
{
	(void)o;
	return put(input->rate, 3, out);
}

static float *write_rate_error(const struct observation *o, const struct observation_input *input, float *out)
{
	(void)input;
	return put(o->error, 3, out);
}

static float *write_rate_error_delta(const struct observation *o, const struct observation_input *input, float *out)
{
	(void)input;
	return put(o->delta, 3, out);
}

static float *write_rate_error_integral(const struct observation *o, const struct observation_input *input,
					float *out)
{
	(void)input;
	return put(o->integral, 3, out);
}

static float *write_previous_action(const struct observation *o, const struct observation_input *input, float *out)
{
	return put(input->previous_action, o->motor_count, out);
}

static float *write_throttle(const struct observation *o, const struct observation_input *input, float *out)
{
	(void)o;
	return put(&input->throttle, 1, out);
}

/* One row a block of the contract, at its code; a block without a writer does not compile. */
static const struct block {
	block_writer *write;
	size_t width; /* 0: one value a motor */
} table[] = {
#define ROW(name, code, width) [code] = { write_##name, width },
	NF_OBSERVATION_BLOCKS(ROW)
#undef ROW
};

enum nf_err observation_init(struct observation *o, const unsigned char *blocks, size_t block_count,
			     size_t motor_count, size_t width, unsigned control_rate_hz)
{
	size_t sum = 0;

	for (size_t i = 0; i < block_count; i++) {
		if (blocks[i] >= sizeof table / sizeof table[0] || !table[blocks[i]].write)
			return NF_ERR_OBSERVATION;
		sum += table[blocks[i]].width ? table[blocks[i]].width : motor_count;
	}
	if (sum != width)
		return NF_ERR_OBSERVATION;
	*o = (struct observation){
		.blocks = blocks,
		.block_count = block_count,
		.motor_count = motor_count,
		.period_s = 1.0f / (float)control_rate_hz,
	};
	observation_reset(o);
	return NF_OK;
}

void observation_reset(struct observation *o)
{
	o->first = true;
	for (int i = 0; i < 3; i++) {
		o->error[i] = 0.0f;
		o->delta[i] = 0.0f;
		o->integral[i] = 0.0f;
	}
}

static void update(struct observation *o, const struct observation_input *input)
{
	for (int i = 0; i < 3; i++) {
		const float error = input->setpoint[i] - input->rate[i];
		o->delta[i] = o->first ? 0.0f : error - o->error[i];
		o->integral[i] = limit(o->integral[i] + error * o->period_s, -NF_RATE_ERROR_INTEGRAL_LIMIT_RAD,
				       NF_RATE_ERROR_INTEGRAL_LIMIT_RAD);
		o->error[i] = error;
	}
	o->first = false;
}

void observation_step(struct observation *o, const struct observation_input *input, float out[])
{
	update(o, input);
	for (size_t i = 0; i < o->block_count; i++)
		out = table[o->blocks[i]].write(o, input, out);
}
