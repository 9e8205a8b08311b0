#include "control/estimator.h"

#include <string.h>

#include "common/limit.h"

void estimator_init(struct estimator *estimator, const struct nf_policy_blob_header *header)
{
	struct estimator_model *model = &estimator->model;

	memset(estimator, 0, sizeof *estimator);
	if (!header || header->model_delay == 0 || header->model_delay > NF_ESTIMATOR_DELAY_MAX)
		return;
	const float *rotor = header->model_rotor;
	*model = (struct estimator_model){
		.delay = header->model_delay,
		.curve = { rotor[0], rotor[1], rotor[2] },
		.rise = rotor[3],
		.fall = rotor[4],
		.gain_max = rotor[5],
		.loss_max = rotor[6],
		.correction = rotor[7],
	};
	for (int motor = 0; motor < POLICY_ACTION_COUNT; ++motor)
		for (int axis = 0; axis < 3; ++axis) {
			model->turn[motor][axis] = header->model_turn[axis * NF_MOTOR_COUNT_MAX + motor];
			model->reaction[motor][axis] = header->model_reaction[axis * NF_MOTOR_COUNT_MAX + motor];
		}
}

void estimator_reset(struct estimator *estimator)
{
	memset(estimator->commands, 0, sizeof estimator->commands);
	memset(estimator->speed, 0, sizeof estimator->speed);
	estimator->oldest = 0;
}

/* The speed at which rotors settle [rad/s]. */
static inline float estimator_target(const struct estimator_model *model, float command)
{
	return (model->curve[0] * command + model->curve[1]) * command + model->curve[2];
}

void estimator_advance(struct estimator *estimator, const float measured[POLICY_ACTION_COUNT], uint32_t silent)
{
	const uint32_t modelled = estimator->measures ? silent : UINT32_MAX;
	const struct estimator_model *model = &estimator->model;
	const float *command = estimator->commands[estimator->oldest];
	const float loss_max = -model->loss_max;

	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		const float speed = estimator->speed[i];
		const float away = estimator_target(model, command[i]) - speed;
		const float change = (away > 0.0f ? model->rise : model->fall) * away;
		const float next = speed + limit(change, loss_max, model->gain_max);
		const float after = !(modelled >> i & 1u) ? measured[i] : next > 0.0f ? next : 0.0f;
		estimator->gained[i] = after - speed;
		estimator->speed[i] = after;
	}
}

/* Adds what the rotors do to the rate: to an axis' sum one product after the other. */
static inline void estimator_add(const float part[POLICY_ACTION_COUNT][3], const float rotors[POLICY_ACTION_COUNT],
				 float sum[3])
{
	float x = sum[0], y = sum[1], z = sum[2];

	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		x += part[i][0] * rotors[i];
		y += part[i][1] * rotors[i];
		z += part[i][2] * rotors[i];
	}
	sum[0] = x;
	sum[1] = y;
	sum[2] = z;
}

void estimator_observe(struct estimator *estimator, const float gyro[3], const float setpoint[3], float rest,
		       bool first, bool held)
{
	const struct estimator_model *model = &estimator->model;
	const float at_rest = estimator_target(model, rest);
	float square[POLICY_ACTION_COUNT];
	float *rate = estimator->rate;

	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		const float speed = estimator->speed[i];
		square[i] = speed * speed;
		estimator->rotor[i] = held ? 0.0f : speed - at_rest;
	}
	if (!held) {
		estimator_add(model->turn, square, rate);
		estimator_add(model->reaction, estimator->gained, rate);
	}
	for (int axis = 0; axis < 3; ++axis) {
		const float predicted = rate[axis];
		rate[axis] = first ? gyro[axis] : predicted + model->correction * (gyro[axis] - predicted);
		estimator->error[axis] = setpoint[axis] - rate[axis];
	}
}

void estimator_command(struct estimator *estimator, const float output[POLICY_ACTION_COUNT], bool standing)
{
	float *command = estimator->commands[estimator->oldest];

	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		command[i] = standing ? 0.0f : output[i];
	estimator->oldest = estimator->oldest == estimator->model.delay ? 0u : estimator->oldest + 1u;
}
