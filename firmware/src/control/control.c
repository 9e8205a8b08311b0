#include "control/control.h"

#include <string.h>

#include "common/limit.h"
#include "common/words.h"

enum nf_err control_init(struct control *control, const struct control_config *config)
{
	static const struct observation_terms terms = {
		.blocks = policy_observation_blocks,
		.ages = policy_observation_ages,
		.gains = policy_observation_gains,
		.count = POLICY_OBSERVATION_TERM_COUNT,
	};
	const struct nf_policy_blob_header *policy = config->policy;
	const float idle = policy ? policy->idle : NF_IDLE_DEFAULT;
	const enum nf_mix mix = policy ? (enum nf_mix)policy->mix : NF_MIX_ATTITUDE_FIRST;
	struct mixer *mixers = control->mixers;
	enum nf_err err;

	memset(control, 0, sizeof *control);
	control->weights = config->weights;
	control->good[CONTROLLER_POLICY] = config->policy_good;
	control->good[CONTROLLER_PID] = config->pid->motor_count == POLICY_ACTION_COUNT;
	control->handover_steps = POLICY_CONTROL_RATE_HZ * NF_HANDOVER_MS / 1000u;
	control->reversed = config->settings->motors_reversed != 0;
	pid_init(&control->pid, config->pid, config->settings);
	dynamic_idle_init(&control->dynamic_idle, config->settings, POLICY_CONTROL_RATE_HZ);
	estimator_init(&control->estimator, policy);
	if ((err = mixer_init(&mixers[CONTROLLER_POLICY], config->settings, idle, mix)) != NF_OK ||
	    (err = mixer_init(&mixers[CONTROLLER_PID], config->settings, config->pid->idle, config->pid->mix)) != NF_OK)
		return err;
	if ((err = observation_init(&control->observation, &terms, POLICY_ACTION_COUNT, POLICY_OBSERVATION_COUNT,
				    POLICY_CONTROL_RATE_HZ)) != NF_OK)
		return err;
	control->estimator.measures = observation_sees(&control->observation, NF_OBSERVATION_ROTOR_MEASURED);
	control->sees_rotors = observation_sees(&control->observation, NF_OBSERVATION_ROTOR_SPEED);
	control_reset(control);
	return NF_OK;
}

static void control_clear(struct control *control, enum controller controller)
{
	if (controller == CONTROLLER_PID) {
		pid_reset(&control->pid);
		return;
	}
	observation_reset(&control->observation);
	policy_init(&control->policy, control->weights);
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		control->action[i] = 0.0f;
		control->motors[i] = 0.0f;
	}
}

/* `controller` begins to fly, its state cleared. */
static void control_begin(struct control *control, enum controller controller)
{
	control->flying = controller;
	control_clear(control, controller);
}

void control_rest(struct control *control)
{
	if (control->fresh)
		return;
	control_clear(control, CONTROLLER_PID);
	control_clear(control, CONTROLLER_POLICY);
	estimator_reset(&control->estimator);
	dynamic_idle_reset(&control->dynamic_idle);
	control->fresh = true;
}

void control_reset(struct control *control)
{
	control->first = true;
	control->latched = control->refused != NF_FALLBACK_NONE;
	control->fallback = control->refused;
	control->misses = 0;
	control->handover_left = 0;
	control->flying = CONTROLLER_POLICY;
	control_rest(control);
}

void control_acknowledge(struct control *control)
{
	control->refused = NF_FALLBACK_NONE;
}

uint32_t control_reasons(const struct control *control, bool pid_wanted)
{
	if (pid_wanted)
		return control->good[CONTROLLER_PID] ? 0u : 1u << NF_ARMING_REASON_PID_MISSING;
	if (!control->good[CONTROLLER_POLICY])
		return 1u << NF_ARMING_REASON_POLICY_BAD;
	return control->refused == NF_FALLBACK_NONE ? 0u : 1u << NF_ARMING_REASON_POLICY_REFUSED;
}

/* From now on the PID flies, where there is one, and the policy is refused until it is acknowledged. */
static void control_fall_back(struct control *control, enum nf_fallback_cause cause)
{
	control->latched = control->good[CONTROLLER_PID];
	if (!control->latched)
		return;
	control->fallback = cause;
	control->refused = cause;
}

/* Returns the controller to fly: the pilot's choice, unless only the other one is usable. */
static enum controller control_choose(const struct control *control, bool pid_wanted)
{
	const enum controller wanted = pid_wanted || control->latched ? CONTROLLER_PID : CONTROLLER_POLICY;
	const enum controller other = wanted == CONTROLLER_PID ? CONTROLLER_POLICY : CONTROLLER_PID;

	return control->good[wanted] || !control->good[other] ? wanted : other;
}

/* Are all outputs within 0..1? False for NaN. */
static bool control_within_range(const float action[POLICY_ACTION_COUNT])
{
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		if (!(action[i] >= 0.0f && action[i] <= 1.0f))
			return false;
	return true;
}

/* Steps the controller that flies. Returns whether its output may be flown. */
static bool control_answer(struct control *control, const struct control_input *input, const float *rotor_speed)
{
	/* Held by the ground nothing moves by what the motors did: a policy that sees its own answers then adds to them. */
	static const float none[POLICY_ACTION_COUNT];
	const struct observation_input seen = {
		.rate = input->rate,
		.setpoint = input->setpoint,
		.previous_action = input->held ? none : control->action,
		.throttle = input->throttle,
		.previous_motors = input->held ? none : control->motors,
		.rotor_speed = rotor_speed,
		.rotor_estimate = control->estimator.rotor,
		.rate_estimate = control->estimator.rate,
		.rate_estimate_error = control->estimator.error,
		.standing = input->standing,
	};

	if (control->flying == CONTROLLER_PID) {
		pid_step(&control->pid, input->setpoint, input->rate, input->throttle, control->action);
	} else {
		observation_step(&control->observation, &seen, control->seen);
		policy_step(&control->policy, control->seen, control->action);
	}
	return control_within_range(control->action);
}

/* Advances the model by a control step, before the controller that flies. */
static __attribute__((noinline)) void control_estimate(struct control *control, const struct control_input *input)
{
	estimator_advance(&control->estimator, input->rotor_speed, input->rotors_silent);
	if (control->flying != CONTROLLER_POLICY)
		return;
	const float rest = mixer_rest(&control->mixers[CONTROLLER_POLICY], input->throttle);
	estimator_observe(&control->estimator, input->rate, input->setpoint, rest, control->observation.first,
			  input->held);
}

/* The outputs of the controller's action; keeps what came of it on the way. */
static void control_mix(struct control *control, float throttle, float output[POLICY_ACTION_COUNT])
{
	const struct mixer *mixer = &control->mixers[control->flying];
	float moved = 0.0f;

	mixer_mix(mixer, control->action, throttle, output);
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i) {
		const float now = output[i] - throttle, change = now - control->motors[i];
		moved += change < 0.0f ? -change : change;
		control->motors[i] = now;
	}
	control->moved = moved;
	mixer_raise(mixer, output, output);
}

/* Blends from the old controller to the new one: the difference at the change fades to 0. */
static void control_hand_over(struct control *control, bool changed, float output[POLICY_ACTION_COUNT])
{
	if (changed) {
		control->handover_left = control->handover_steps;
		for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
			control->offset[i] = control->output[i] - output[i];
	}
	if (control->handover_left == 0)
		return;
	--control->handover_left;
	const float share = (float)control->handover_left / (float)control->handover_steps;
	const float most = control->mixers[control->flying].limit;
	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		output[i] = limit(output[i] + share * control->offset[i], 0.0f, most);
}

/* Rotor speeds are missing of a policy that observes them. Writes them, those that are missing from its model. */
static __attribute__((noinline)) void control_model_rotors(struct control *control, const struct control_input *input,
							   float speed[POLICY_ACTION_COUNT])
{
	const bool modelled = control->estimator.model.delay > 0;

	for (int i = 0; i < POLICY_ACTION_COUNT; ++i)
		speed[i] = modelled && (input->rotors_silent >> i & 1u) ? control->estimator.speed[i] :
									  input->rotor_speed[i];
}

static bool control_fly(struct control *control, const struct control_input *input, float output[POLICY_ACTION_COUNT])
{
	const enum controller before = control->flying;
	const bool lacks = control->sees_rotors && input->rotors_silent != 0;
	float modelled[POLICY_ACTION_COUNT];

	if (lacks && control->estimator.model.delay == 0 && !control->latched && !input->pid_wanted &&
	    control->good[CONTROLLER_POLICY])
		control_fall_back(control, NF_FALLBACK_ROTORS);
	const enum controller chosen = control_choose(control, input->pid_wanted);

	control->fresh = false;
	control->pid.standing = input->standing;
	if (chosen != before) {
		control_begin(control, chosen);
		if (!control->latched)
			control->fallback = chosen == CONTROLLER_PID ? NF_FALLBACK_SWITCH : NF_FALLBACK_NONE;
	}
	if (control->dynamic_idle.wanted > 0.0f)
		mixer_raise_idle(&control->mixers[chosen],
				 dynamic_idle_step(&control->dynamic_idle, input->rotor_speed, input->rotors_silent));
	if (control->estimator.model.delay > 0)
		control_estimate(control, input);
	if (lacks)
		control_model_rotors(control, input, modelled);
	if (!control_answer(control, input, lacks ? modelled : input->rotor_speed)) {
		control_fall_back(control, NF_FALLBACK_POLICY_OUTPUT);
		if (!control->latched) {
			control->good[CONTROLLER_POLICY] = false;
			return false;
		}
		control_begin(control, CONTROLLER_PID);
		control_answer(control, input, input->rotor_speed);
	}
	control_mix(control, input->throttle, output);
	control_hand_over(control, control->flying != before && !control->first && !control->distrusted, output);
	words_copy(control->output, output, sizeof control->output);
	if (control->estimator.model.delay > 0)
		estimator_command(&control->estimator, output,
				  mixer_stops(&control->mixers[control->flying], input->throttle));
	control->first = false;
	control->distrusted = false;
	return true;
}

/* Motors that turn the other way roll and pitch the aircraft as ever, and yaw it the other way: a controller that sees yaw
 * with the other sign steers rightly. */
static __attribute__((noinline)) bool control_fly_reversed(struct control *control, const struct control_input *input,
							   float output[POLICY_ACTION_COUNT])
{
	const float setpoint[3] = { input->setpoint[0], input->setpoint[1], -input->setpoint[2] };
	const float rate[3] = { input->rate[0], input->rate[1], -input->rate[2] };
	struct control_input seen = *input;

	seen.setpoint = setpoint;
	seen.rate = rate;
	return control_fly(control, &seen, output);
}

bool control_step(struct control *control, const struct control_input *input, float output[POLICY_ACTION_COUNT])
{
	return control->reversed ? control_fly_reversed(control, input, output) : control_fly(control, input, output);
}

void control_deadline(struct control *control, bool missed)
{
	control->misses = missed ? (uint8_t)(control->misses + 1u) : 0u;
	if (control->misses < NF_DEADLINE_MISSES_MAX)
		return;
	control->misses = 0;
	if (control->flying == CONTROLLER_POLICY)
		control_fall_back(control, NF_FALLBACK_DEADLINE);
}

bool control_distrust(struct control *control, enum nf_fallback_cause cause)
{
	if (control->flying != CONTROLLER_POLICY)
		return false;
	control_fall_back(control, cause);
	control->distrusted = control->latched;
	return control->latched;
}

void control_policy_good(struct control *control, bool good)
{
	control->good[CONTROLLER_POLICY] = good;
}

bool control_demand(const struct control *control, float demand[3])
{
	const struct pid_gains *gains = control->pid.gains;
	float roll = 0.0f, pitch = 0.0f, yaw = 0.0f;

	for (uint32_t m = 0; m < gains->motor_count; ++m) {
		const float *share = gains->mixer[m];
		roll += share[0] * control->action[m];
		pitch += share[1] * control->action[m];
		yaw += share[2] * control->action[m];
	}
	demand[0] = roll;
	demand[1] = pitch;
	demand[2] = yaw;
	if (control->reversed)
		demand[2] = -demand[2];
	return gains->motor_count > 0;
}

float control_spread(const struct control *control)
{
	float least = control->action[0], most = control->action[0];

	for (int i = 1; i < POLICY_ACTION_COUNT; ++i) {
		least = control->action[i] < least ? control->action[i] : least;
		most = control->action[i] > most ? control->action[i] : most;
	}
	return most - least;
}
