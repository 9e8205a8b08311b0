/* Control: chooses between policy and PID and blends the outputs when it changes. */
#pragma once

#include "common/held.h"
#include "control/dynamic_idle.h"
#include "control/estimator.h"
#include "control/mixer.h"
#include "control/observation.h"
#include "control/pid.h"
#include "nf_contract.h"
#include "policy.h"

enum controller {
	CONTROLLER_POLICY,
	CONTROLLER_PID,
	CONTROLLER_COUNT,
};

struct control_config {
	const struct nf_settings *settings;
	const float *weights;          /* [POLICY_WEIGHT_COUNT], 8-byte aligned; where policy_step reads them */
	const struct nf_policy_blob_header *policy; /* of the blob that the weights are of, checked: its idle, mix and
						     * model are copied; NULL: none is good */
	bool policy_good;              /* checked and self-tested */
	const struct pid_gains *pid;   /* its motor_count is 0 where there is none */
};

/* Input of a control step. */
struct control_input {
	const float *setpoint;         /* [3] rad/s, body */
	const float *rate;             /* [3] rad/s, body */
	float throttle;                /* 0..1 */
	const float *rotor_speed;      /* [POLICY_ACTION_COUNT] rad/s, as ESCs tell it */
	uint32_t rotors_silent;        /* bit field: motors whose speed is not known */
	bool pid_wanted;               /* the pilot's switch */
	bool standing;                 /* it has not taken off: integrals do not grow */
	bool held;                     /* nor is the throttle raised so far: the policy does not see what it has
					* answered */
};

struct control {
	struct policy policy;
	struct observation observation;
	struct estimator estimator;
	struct pid pid;
	struct dynamic_idle dynamic_idle;
	struct mixer mixers[CONTROLLER_COUNT]; /* each with its controller's idle and mix */
	HELD(const float *, weights);
	bool good[CONTROLLER_COUNT];         /* may fly */
	enum nf_fallback_cause refused;      /* why the policy must not fly until it is acknowledged; NONE: it may */
	bool reversed;                       /* the motors turn the other way than the controllers know them */
	bool sees_rotors;                    /* the policy observes rotor speeds */
	bool first;                          /* no step since the reset */
	bool fresh;                          /* the controllers remember nothing */
	enum controller flying;              /* since the last step */
	enum nf_fallback_cause fallback;     /* why the PID flies instead of the policy, or flew last */
	bool latched;                        /* it flies until the next reset */
	bool distrusted;                     /* since the last step: nothing of the old outputs is to be kept */
	uint8_t misses;                      /* missed deadlines in a row, at most NF_DEADLINE_MISSES_MAX */
	float seen[POLICY_OBSERVATION_COUNT]; /* what the policy was given last */
	float action[POLICY_ACTION_COUNT];   /* the controller's last output, 0..1, before the throttle */
	float motors[POLICY_ACTION_COUNT];   /* what came of it before the idle, less the throttle */
	float moved;                         /* how far they moved in the last step, all together */
	float output[POLICY_ACTION_COUNT];   /* and what was commanded */
	float offset[POLICY_ACTION_COUNT];   /* of the outputs at the last change of controller */
	uint32_t handover_left;              /* control steps of the hand-over under way */
	uint32_t handover_steps;
};

/* NF_ERR_IDLE, NF_ERR_OBSERVATION: do not run this firmware. What `config` points to must outlive the control. */
enum nf_err control_init(struct control *control, const struct control_config *config);

/* A flight begins: nothing from before reaches its first step, except that a refused policy stays refused. */
void control_reset(struct control *control);

/* The pilot knows why the policy was refused: it may fly from the next reset on. Only while the motors stand still. */
void control_acknowledge(struct control *control);

/* Disarmed: clears the controllers' state, so that the step that arms takes no longer than the others. */
void control_rest(struct control *control);

/* Which reasons forbid arming with the switch so: POLICY_BAD, POLICY_REFUSED, PID_MISSING or none. */
uint32_t control_reasons(const struct control *control, bool pid_wanted);

/* One control step: writes the motors' fractions, 0..1. Where the policy observes the speed of a rotor whose ESC is silent, it
 * gets the one that its model of the aircraft has; a policy without a model is not flown: the PID takes over, and the policy is
 * refused until it is acknowledged. Where there is no PID, it flies on with the last speed. An output of the policy that is NaN or out of range is never
 * flown: the PID computes the same step, and the policy is refused until it is acknowledged. Returns false, `output`
 * unset, if there is no PID to do so; that policy is bad from then on. */
bool control_step(struct control *control, const struct control_input *input, float output[POLICY_ACTION_COUNT]);

/* Did the last control step end after its deadline? NF_DEADLINE_MISSES_MAX times in a row: the PID flies, where there
 * is one, and the policy is refused until it is acknowledged. */
void control_deadline(struct control *control, bool missed);

/* The outputs were legal but not plausible, or the policy's weights are wrong: where the policy flies, the PID takes over if
 * there is one, at once, without a hand-over, and the policy is refused until it is acknowledged. Returns whether that
 * happened. */
bool control_distrust(struct control *control, enum nf_fallback_cause cause);

/* The policy may not fly from the next control step on, or may again, its weights having passed their self-test. */
void control_policy_good(struct control *control, bool good);

/* What the last outputs ask of each axis of the aircraft, by the PID's mixer; its sign counts. Returns false where no PID is built in. */
bool control_demand(const struct control *control, float demand[3]);

/* Largest minus smallest motor of the controller's last output, 0..1. */
float control_spread(const struct control *control);
