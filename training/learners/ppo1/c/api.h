/* What Python calls and fills in. Read by the C compiler and by cffi.
 *
 * Arrays belong to Python and outlive the structs that point to them. N is the number of samples of a rollout, n that of
 * observed values, M that of motors. `real` is float for training and double for tests. */

#ifndef PPO1_API_H
#define PPO1_API_H

#include "network/c/api.h"

enum { PPO1_FIGURES = 3 };

/* An epoch: each minibatch is followed by a step of Adam. */
struct epoch {
	struct network actor, critic;
	uint32_t count;          /* of the samples that `order` names: whole minibatches */
	uint32_t minibatch;
	const int32_t *order;    /* (count) samples */
	struct observed observed;
	const real *actions;     /* (N, M), drawn network outputs */
	const real *log_prob;    /* (N), of the actions before the update, as `ppo1_log_prob` has them */
	const real *advantages;  /* (N) */
	const real *returns;     /* (N), in units of the critic */
	real clip, entropy;
	struct adam adam;
	/* Actor, log_std (M), critic: */
	real *parameters;
	real *gradient;          /* the last one */
	double *figures;         /* (PPO1_FIGURES): means of surrogate, value loss, share of clipped ratios */
};

/* Memory [numbers] for `ppo1_epoch` with these networks. */
size_t ppo1_memory(const struct network *actor, const struct network *critic);

/* Log-likelihood of actions (count, M) under means (count, M), without its constant. */
void ppo1_log_prob(uint32_t count, uint32_t motors, const real *actions, const real *means, const real *log_std,
		   real *log_prob);

void ppo1_epoch(const struct epoch *e, real *memory);

#endif
