#include "safety/safety.h"

_Static_assert(NF_ARMING_REASON_COUNT <= 32, "a bit each");
#define OWN_REASONS (SAFETY_REASON(SWITCH_NOT_CYCLED) | SAFETY_REASON(CRASHED))

/* Inputs that safety adds itself. */
enum {
	READY = SAFETY_INPUTS_END,             /* the switch was off at the last update */
	DROPPED = SAFETY_INPUTS_END << 1,      /* in FAILSAFE_DROP the motors have stopped */
	LOST = SAFETY_INPUTS_END << 2,         /* these, by the reasons: RECEIVER_LOST */
	UNCALIBRATED = SAFETY_INPUTS_END << 3, /* GYRO_NOT_CALIBRATED */
	FORBIDDEN = SAFETY_INPUTS_END << 4,    /* any that nobody else computes */
};

#define IN(state) (1u << NF_FLIGHT_##state)
#define FLYING (IN(ARMED) | IN(FAILSAFE_HOLD))
#define TURNING (FLYING | IN(FAILSAFE_DROP))

/* The first row that fits moves the state; none leaves it. A row fits in the states of `from` when all inputs of
 * `all` and none of `none` hold.
 *
 * Arming takes a switch that moves: at the last update it was off with the receiver heard, and at the update that
 * sees it on nothing forbids arming. A switch moved too early, or found on when the receiver returns, must be moved off
 * and on again. */
static const struct transition {
	uint32_t from, all, none;
	enum nf_flight_state to;
	enum nf_stop_cause cause;
} transitions[] = {
	/* No controller flies without a gyro; stopped motors need none. */
	{ TURNING, SAFETY_GYRO_INVALID, DROPPED, NF_FLIGHT_FAULT, NF_STOP_GYRO_INVALID },
	{ TURNING, SAFETY_GYRO_STUCK, DROPPED, NF_FLIGHT_FAULT, NF_STOP_GYRO_STUCK },
	{ TURNING, SAFETY_GYRO_SILENT, DROPPED, NF_FLIGHT_FAULT, NF_STOP_GYRO_SILENT },
	/* The aircraft tumbles faster than its gyro can tell, or the gyro is dead. A tumble ends on the ground, where it may
	 * arm again; a dead gyro stays at its end, which forbids arming. */
	{ TURNING, SAFETY_GYRO_SATURATED, DROPPED, NF_FLIGHT_CRASHED, NF_STOP_GYRO_SATURATED },
	{ TURNING, SAFETY_NO_CONTROLLER, DROPPED, NF_FLIGHT_DISARMED, NF_STOP_NO_CONTROLLER },
	{ TURNING, SAFETY_CRASH, DROPPED, NF_FLIGHT_CRASHED, NF_STOP_CRASH },
	{ TURNING, SAFETY_RUNAWAY, DROPPED, NF_FLIGHT_CRASHED, NF_STOP_RUNAWAY },
	/* The switch of a lost receiver is not used. */
	{ FLYING, LOST, 0, NF_FLIGHT_FAILSAFE_DROP, NF_STOP_RECEIVER },
	{ FLYING, 0, SAFETY_SWITCH_ON, NF_FLIGHT_DISARMED, NF_STOP_SWITCH },
	{ IN(ARMED), SAFETY_RECEIVER_HELD, 0, NF_FLIGHT_FAILSAFE_HOLD, NF_STOP_NONE },
	{ IN(FAILSAFE_HOLD), 0, SAFETY_RECEIVER_HELD, NF_FLIGHT_ARMED, NF_STOP_NONE },
	/* But a pilot whose frames come again, on a poor link too, may end a descent. */
	{ IN(FAILSAFE_DROP), SAFETY_OFF_HEARD, DROPPED, NF_FLIGHT_DISARMED, NF_STOP_SWITCH },
	{ IN(FAILSAFE_DROP) | IN(CRASHED), 0, SAFETY_SWITCH_ON | LOST, NF_FLIGHT_DISARMED, NF_STOP_NONE },
	{ IN(BOOT), 0, 0, NF_FLIGHT_CALIBRATING, NF_STOP_NONE },
	{ IN(CALIBRATING), 0, UNCALIBRATED, NF_FLIGHT_DISARMED, NF_STOP_NONE },
	{ IN(DISARMED), UNCALIBRATED, 0, NF_FLIGHT_CALIBRATING, NF_STOP_NONE },
	{ IN(DISARMED), READY | SAFETY_SWITCH_ON, FORBIDDEN, NF_FLIGHT_ARMED, NF_STOP_NONE },
};

void safety_init(struct safety *safety, const struct nf_settings *settings, unsigned control_rate_hz)
{
	/* 60 s at 8 kHz are 29 bits. */
	const uint32_t step_milliseconds = settings->failsafe_descend_ms * control_rate_hz;

	*safety = (struct safety){
		.state = NF_FLIGHT_BOOT,
		.stop_cause = NF_STOP_NONE,
		.descends = settings->failsafe_stage == NF_FAILSAFE_STAGE_DESCEND,
		.descent_steps = step_milliseconds / 1000u,
	};
}

static const struct transition *safety_matching(enum nf_flight_state state, uint32_t inputs)
{
	for (size_t i = 0; i < sizeof transitions / sizeof transitions[0]; ++i) {
		const struct transition *t = &transitions[i];
		if ((t->from & 1u << state) && (inputs & t->all) == t->all && (inputs & t->none) == 0)
			return t;
	}
	return NULL;
}

static uint32_t safety_own_inputs(const struct safety *safety, uint32_t reasons)
{
	return (safety->ready ? READY : 0u) |
	       (safety->state == NF_FLIGHT_FAILSAFE_DROP && safety->descent_left == 0 ? DROPPED : 0u) |
	       ((reasons & SAFETY_REASON(RECEIVER_LOST)) ? LOST : 0u) |
	       ((reasons & SAFETY_REASON(GYRO_NOT_CALIBRATED)) ? UNCALIBRATED : 0u) |
	       ((reasons & ~OWN_REASONS) ? FORBIDDEN : 0u);
}

bool safety_update(struct safety *safety, struct safety_conditions conditions)
{
	const enum nf_flight_state before = safety->state;
	const uint32_t inputs = conditions.inputs | safety_own_inputs(safety, conditions.reasons);
	const struct transition *t = safety_matching(before, inputs);

	if (t) {
		safety->state = t->to;
		if (t->cause != NF_STOP_NONE)
			safety->stop_cause = t->cause;
		if (t->to == NF_FLIGHT_FAILSAFE_DROP)
			safety->descent_left = safety->descends ? safety->descent_steps : 0;
	}
	safety->ready = (inputs & (SAFETY_SWITCH_ON | LOST)) == 0;
	return before == NF_FLIGHT_DISARMED && safety->state == NF_FLIGHT_ARMED;
}

void safety_tick(struct safety *safety)
{
	if (safety->descent_left > 0)
		--safety->descent_left;
}

bool safety_descending(const struct safety *safety)
{
	return safety->state == NF_FLIGHT_FAILSAFE_DROP && safety->descent_left > 0;
}

bool safety_motors(const struct safety *safety)
{
	return (FLYING & 1u << safety->state) != 0 || safety_descending(safety);
}

uint32_t safety_reasons(const struct safety *safety, uint32_t reasons)
{
	if (safety_motors(safety))
		return 0;
	return (reasons & ~OWN_REASONS) | (safety->ready ? 0u : SAFETY_REASON(SWITCH_NOT_CYCLED)) |
	       (safety->state == NF_FLIGHT_CRASHED ? SAFETY_REASON(CRASHED) : 0u) |
	       (safety->state == NF_FLIGHT_FAULT ? SAFETY_REASON(FAULT) : 0u);
}
