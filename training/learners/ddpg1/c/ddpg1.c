/* DDPG's losses and their gradients by actor and critic, LANES samples at once, and actors that each have own parameters. */
#include "api.h"
#include "network/c/activation.h"
#include "network/c/adam.h"
#include "network/c/computed.h"

/* Memory of a critic and of its rows. */
struct judged {
	const struct critic *critic;
	struct dense first;
	struct layers rest;
	real *inputs, *joined, *value;           /* normalized observation; first layer's values, then the action */
	real *by_inputs, *by_first, *by_joined, *by_value;
};

static size_t judged_motors(const struct judged *c)
{
	return c->critic->rest.width[0] - c->critic->units;
}

static size_t judged_first_count(const struct critic *critic)
{
	return (critic->inputs + 1u) * (size_t)critic->units;
}

static void judged_layout(struct judged *c, struct arena *a, const struct critic *critic)
{
	const size_t inputs = padded(critic->inputs, LANES);
	const size_t joined = padded(padded(critic->units, TILE) + critic->rest.width[0] - critic->units, LANES);

	c->critic = critic;
	dense_layout(&c->first, a, critic->inputs, critic->units);
	layers_layout(&c->rest, a, &critic->rest, 1);
	c->inputs = arena_rows(a, inputs);
	c->joined = arena_rows(a, joined);
	c->value = arena_rows(a, TILE);
	c->by_inputs = arena_rows(a, inputs);
	c->by_first = arena_rows(a, joined);
	c->by_joined = arena_rows(a, joined);
	c->by_value = arena_rows(a, TILE);
	if (a->memory != NULL) {
		rows_clear(c->inputs, inputs);
		rows_clear(c->joined, joined);
		rows_clear(c->by_first, joined);
		rows_clear(c->by_value, TILE);
	}
}

static void judged_load(struct judged *c, const real *parameters)
{
	layers_load(&c->rest, dense_load(&c->first, parameters));
}

/* The value of `inputs` with these actions, rows (M). */
static void judged_forward(struct judged *c, const real *actions)
{
	const size_t units = c->critic->units;

	dense_forward(&c->first, c->inputs, c->joined);
	layers_squash(c->critic->rest.activation, c->joined, padded(units, TILE));
	rows_copy(c->joined + units * LANES, actions, judged_motors(c));
	layers_forward(&c->rest, 0, c->joined, c->value);
}

/* From the derivatives by the value to the sums of those by the parameters. */
static void judged_backward(struct judged *c)
{
	layers_backward(&c->rest, 0, c->joined, c->by_value, c->by_joined);
	layers_unsquash(c->critic->rest.activation, c->joined, c->by_joined, c->by_first, c->critic->units);
	dense_gather(&c->first, c->by_first, c->inputs);
}

/* Rows of up to LANES samples' numbers from `place` in their rows on; other lanes are 0. */
static void taken(real *rows, const struct observed *o, const int32_t *order, size_t samples, size_t place, size_t count)
{
	for (size_t l = 0; l < LANES; ++l)
		for (size_t i = 0; i < count; ++i)
			rows[i * LANES + l] = l < samples ? o->values[(size_t)order[l] * o->stride + place + i] : R(0);
}

/* Memory of an update. */
struct learning {
	struct computed actor, actor_target;
	struct judged critic, critic_target;
	real *actions, *wanted; /* rows */
	size_t actor_count, first_count, critic_count;
};

static void learning_layout(struct learning *m, struct arena *a, const struct network *actor, const struct critic *critic)
{
	computed_layout(&m->actor, a, actor);
	computed_layout(&m->actor_target, a, actor);
	judged_layout(&m->critic, a, critic);
	judged_layout(&m->critic_target, a, critic);
	m->actions = arena_rows(a, actor->width[actor->layers]);
	m->wanted = arena_rows(a, 1);
	m->actor_count = parameter_count(actor);
	m->first_count = judged_first_count(critic);
	m->critic_count = m->first_count + parameter_count(&critic->rest);
	if (a->memory != NULL) {
		rows_clear(m->actor.inputs, padded(actor->width[0], LANES));
		rows_clear(m->actor_target.inputs, padded(actor->width[0], LANES));
	}
}

/* How many of the samples that are left are the next block. */
static size_t block(size_t left)
{
	return left < LANES ? left : LANES;
}

size_t ddpg1_memory(const struct network *actor, const struct critic *critic)
{
	struct arena a = {0};
	struct learning m;

	learning_layout(&m, &a, actor, critic);
	return a.used;
}

/* What the critic should say of a block's steps: reward and discounted value of what follows, by the targets. */
static void learning_want(struct learning *m, const struct updates *u, const int32_t *order, size_t samples)
{
	const size_t n = u->critic.inputs, motors = judged_motors(&m->critic);
	struct observed next = u->observed;

	next.values += n + motors + 1u;
	computed_take(&m->actor_target, &next, order, 0, samples);
	layers_forward(&m->actor_target.layers, 0, m->actor_target.inputs, m->actor_target.outputs);
	rows_copy(m->critic_target.inputs, m->actor_target.inputs, n);
	judged_forward(&m->critic_target, m->actor_target.outputs);
	taken(m->wanted, &u->observed, order, samples, n + motors, 1);
	FOR_LANES(l)
		m->wanted[l] += u->discount * m->critic_target.value[l];
}

/* Adds a block to the critic's gradient. */
static void learning_judge(struct learning *m, const struct updates *u, const int32_t *order, size_t samples, real share)
{
	const size_t n = u->critic.inputs;

	learning_want(m, u, order, samples);
	computed_take(&m->actor, &u->observed, order, 0, samples);
	rows_copy(m->critic.inputs, m->actor.inputs, n);
	taken(m->actions, &u->observed, order, samples, n, judged_motors(&m->critic));
	judged_forward(&m->critic, m->actions);
	for (size_t l = 0; l < LANES; ++l) {
		const real error = l < samples ? m->critic.value[l] - m->wanted[l] : R(0);

		m->critic.by_value[l] = R(2) * share * error;
		u->figures[0] += error * error;
	}
	judged_backward(&m->critic);
}

/* Adds a block to the actor's gradient: its outputs should have a higher value. */
static void learning_act(struct learning *m, const struct updates *u, const int32_t *order, size_t samples, real share)
{
	struct computed *const actor = &m->actor;
	struct judged *const critic = &m->critic;

	computed_take(actor, &u->observed, order, 0, samples);
	rows_copy(critic->inputs, actor->inputs, u->critic.inputs);
	layers_forward(&actor->layers, 0, actor->inputs, actor->outputs);
	judged_forward(critic, actor->outputs);
	for (size_t l = 0; l < LANES; ++l) {
		critic->by_value[l] = l < samples ? -share : R(0);
		u->figures[1] += l < samples ? critic->value[l] : R(0);
	}
	layers_backward(&critic->rest, 0, critic->joined, critic->by_value, critic->by_joined);
	layers_backward(&actor->layers, 0, actor->inputs, critic->by_joined + u->critic.units * LANES, actor->by_inputs);
}

/* Adds derivatives of the squared weights, halved: of all weights of the critic but those of its last layer. */
static void learning_decay(const struct updates *u, const real *parameters, real *gradient)
{
	const struct network *const rest = &u->critic.rest;
	size_t outputs = u->critic.units, weights = outputs * u->critic.inputs;

	for (size_t i = 0; i < rest->layers; ++i) {
		_Pragma("GCC ivdep") for (size_t j = 0; j < weights; ++j)
			gradient[j] += u->decay * parameters[j];
		parameters += weights + outputs;
		gradient += weights + outputs;
		outputs = rest->width[i + 1u];
		weights = outputs * rest->width[i];
	}
}

void ddpg1_update(const struct updates *u, real *memory)
{
	struct arena a = {memory, 0};
	struct learning m;
	const real share = R(1) / (real)u->minibatch;

	learning_layout(&m, &a, &u->actor, &u->critic);
	memset(u->figures, 0, DDPG1_FIGURES * sizeof(double));
	for (uint32_t k = 0; k < u->count; ++k) {
		const int32_t *const order = u->drawn + (size_t)k * u->minibatch;
		real *const parameters = u->parameters, *const critic = parameters + m.actor_count;

		layers_load(&m.actor.layers, parameters);
		judged_load(&m.critic, critic);
		layers_load(&m.actor_target.layers, u->targets);
		judged_load(&m.critic_target, u->targets + m.actor_count);
		for (uint32_t start = 0; start < u->minibatch; start += LANES)
			learning_judge(&m, u, order + start, block(u->minibatch - start), share);
		layers_store(&m.critic.rest, dense_store(&m.critic.first, u->gradient + m.actor_count));
		learning_decay(u, critic, u->gradient + m.actor_count);
		/* Goes through the critic, whose sums of derivatives are not needed any more. */
		for (uint32_t start = 0; start < u->minibatch; start += LANES)
			learning_act(&m, u, order + start, block(u->minibatch - start), share);
		layers_store(&m.actor.layers, u->gradient);
		adam_step(&u->adam[0], u->adam[0].updates + k + 1u, parameters, u->gradient, m.actor_count);
		adam_step(&u->adam[1], u->adam[1].updates + k + 1u, critic, u->gradient + m.actor_count, m.critic_count);
		_Pragma("GCC ivdep") for (size_t i = 0; i < m.actor_count + m.critic_count; ++i)
			u->targets[i] += u->tau * (parameters[i] - u->targets[i]);
	}
	for (size_t i = 0; i < DDPG1_FIGURES; ++i)
		u->figures[i] /= (double)u->count * u->minibatch;
}

void ddpg1_values(const struct critic *critic, const real *parameters, uint32_t count, const struct observed *observed,
		  real *values, real *memory)
{
	struct arena a = {memory, 0};
	struct judged c;
	const size_t n = critic->inputs, motors = critic->rest.width[0] - critic->units;

	judged_layout(&c, &a, critic);
	judged_load(&c, parameters);
	for (size_t k = 0; k < count; ++k) {
		const real *const row = observed->values + k * observed->stride;

		for (size_t i = 0; i < n; ++i)
			c.inputs[i * LANES] = (row[i] - observed->mean[i]) * observed->factor[i];
		for (size_t i = 0; i < motors; ++i)
			c.by_first[i * LANES] = row[n + i];
		judged_forward(&c, c.by_first);
		values[k] = c.value[0];
	}
}

void ddpg1_act(const struct network *actor, const real *parameters, uint32_t count, const struct observed *observed,
	       real *outputs, real *memory)
{
	size_t widest = 0, motors = actor->width[actor->layers];

	for (size_t i = 0; i <= actor->layers; ++i)
		widest = actor->width[i] > widest ? actor->width[i] : widest;

	real *x = memory, *y = memory + widest * count;

	for (size_t i = 0; i < actor->width[0]; ++i)
		for (size_t k = 0; k < count; ++k)
			x[i * count + k] = (observed->values[k * observed->stride + i] - observed->mean[i]) *
					   observed->factor[i];
	for (size_t i = 0; i < actor->layers; ++i) {
		const size_t wide = actor->width[i], units = actor->width[i + 1u];
		const real *weight = parameters, *const bias = parameters + wide * units * count;
		const bool squashed = i + 1u == actor->layers || actor->activation == ACTIVATION_TANH;
		real *const before = x;

		for (size_t o = 0; o < units; ++o) {
			real *restrict const sum = y + o * count;

			memcpy(sum, bias + o * count, count * sizeof(real));
			for (size_t j = 0; j < wide; ++j, weight += count)
				for (size_t k = 0; k < count; ++k)
					sum[k] += weight[k] * x[j * count + k];
			for (size_t k = 0; k < count; ++k)
				sum[k] = squashed ? tanh_of(sum[k]) : most(sum[k], R(0));
		}
		parameters = bias + units * count;
		x = y;
		y = before;
	}
	for (size_t k = 0; k < count; ++k)
		for (size_t m = 0; m < motors; ++m)
			outputs[k * motors + m] = x[m * count + k];
}
