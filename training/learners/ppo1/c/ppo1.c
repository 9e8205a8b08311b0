/* PPO's losses and their gradients by actor and critic, LANES samples at once. */
#include "api.h"
#include "network/c/adam.h"
#include "network/c/computed.h"

#ifdef FLOAT64
#define real_exp exp
#else
#define real_exp expf
#endif

size_t ppo1_memory(const struct network *actor, const struct network *critic)
{
	struct arena a = {0};
	struct computed computed;

	computed_layout(&computed, &a, actor);
	computed_layout(&computed, &a, critic);
	return a.used;
}

void ppo1_log_prob(uint32_t count, uint32_t motors, const real *actions, const real *means, const real *log_std,
		   real *log_prob)
{
	for (size_t k = 0; k < count; ++k) {
		real sum = R(0);

		for (size_t m = 0; m < motors; ++m) {
			const real away = (actions[k * motors + m] - means[k * motors + m]) * real_exp(-log_std[m]);

			sum -= R(0.5) * away * away + log_std[m];
		}
		log_prob[k] = sum;
	}
}

/* Adds a block's surrogate and its derivatives by the means and by log_std; `share` is a sample's of the minibatch. */
static void surrogate(const struct epoch *e, struct computed *actor, const int32_t *order, size_t samples, real share,
		      const real *log_std, real *by_log_std)
{
	const size_t motors = e->actor.width[e->actor.layers];

	rows_clear(actor->by_outputs, motors);
	for (size_t l = 0; l < samples; ++l) {
		const size_t sample = (size_t)order[l];
		const real *const action = e->actions + sample * motors;
		const real advantage = e->advantages[sample];
		real log_prob = R(0), ratio, kept, by_log_prob;

		for (size_t m = 0; m < motors; ++m) {
			const real away = (action[m] - actor->outputs[m * LANES + l]) * real_exp(-log_std[m]);

			log_prob -= R(0.5) * away * away + log_std[m];
		}
		ratio = real_exp(log_prob - e->log_prob[sample]);
		kept = limited(ratio, R(1) - e->clip, R(1) + e->clip);
		/* The lesser of the two has a derivative unless it is the clipped one. */
		by_log_prob = advantage * ratio <= advantage * kept ? -share * advantage * ratio : R(0);
		for (size_t m = 0; m < motors; ++m) {
			const real over = real_exp(-log_std[m]);
			const real away = (action[m] - actor->outputs[m * LANES + l]) * over;

			actor->by_outputs[m * LANES + l] = by_log_prob * away * over;
			by_log_std[m] += by_log_prob * (away * away - R(1));
		}
		e->figures[0] += least(advantage * ratio, advantage * kept);
		e->figures[2] += ratio != kept;
	}
	for (size_t m = 0; m < motors; ++m)
		by_log_std[m] -= e->entropy * share * (real)samples;
}

/* Adds a block's squared errors of the critic and their derivatives by its values. */
static void value_loss(const struct epoch *e, struct computed *critic, const int32_t *order, size_t samples, real share)
{
	rows_clear(critic->by_outputs, 1);
	for (size_t l = 0; l < samples; ++l) {
		const real error = critic->outputs[l] - e->returns[order[l]];

		critic->by_outputs[l] = R(2) * share * error;
		e->figures[1] += error * error;
	}
}

void ppo1_epoch(const struct epoch *e, real *memory)
{
	struct arena a = {memory, 0};
	struct computed actor, critic;
	const size_t motors = e->actor.width[e->actor.layers], before = parameter_count(&e->actor);
	const size_t count = before + motors + parameter_count(&e->critic);
	const real share = R(1) / (real)e->minibatch;
	real *const log_std = e->parameters + before, *const by_log_std = e->gradient + before;

	computed_layout(&actor, &a, &e->actor);
	computed_layout(&critic, &a, &e->critic);
	rows_clear(actor.inputs, padded(e->actor.width[0], LANES));
	rows_clear(critic.inputs, padded(e->critic.width[0], LANES));
	memset(e->figures, 0, PPO1_FIGURES * sizeof(double));
	for (uint32_t batch = 0; batch + e->minibatch <= e->count; batch += e->minibatch) {
		layers_load(&actor.layers, e->parameters);
		layers_load(&critic.layers, log_std + motors);
		memset(by_log_std, 0, motors * sizeof(real));
		for (uint32_t start = 0; start < e->minibatch; start += LANES) {
			const size_t samples = e->minibatch - start < LANES ? e->minibatch - start : LANES;
			const int32_t *const order = e->order + batch + start;

			computed_take(&actor, &e->observed, order, 0, samples);
			rows_copy(critic.inputs, actor.inputs, e->actor.width[0]);
			layers_forward(&actor.layers, 0, actor.inputs, actor.outputs);
			layers_forward(&critic.layers, 0, critic.inputs, critic.outputs);
			surrogate(e, &actor, order, samples, share, log_std, by_log_std);
			value_loss(e, &critic, order, samples, share);
			layers_backward(&actor.layers, 0, actor.inputs, actor.by_outputs, actor.by_inputs);
			layers_backward(&critic.layers, 0, critic.inputs, critic.by_outputs, critic.by_inputs);
		}
		layers_store(&actor.layers, e->gradient);
		layers_store(&critic.layers, by_log_std + motors);
		adam_step(&e->adam, e->adam.updates + batch / e->minibatch + 1u, e->parameters, e->gradient, count);
	}
	for (size_t i = 0; i < PPO1_FIGURES; ++i)
		e->figures[i] /= e->count;
}
