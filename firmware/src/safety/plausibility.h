/* Plausibility: does the controller do what its aircraft needs, although all its outputs are legal numbers? */
#pragma once

#include "nf_contract.h"
#include "safety/turning.h"

struct plausibility_input {
	const float *setpoint;         /* [3] rad/s, body */
	const float *rate;             /* [3] rad/s, body */
	const float *demand;           /* [3] what the outputs ask of each axis, with its sign; NULL: not known */
	const struct turning *turning; /* after this control step */
	const float *room;             /* [3] rad/s, that errors may swing on top, as the chirp makes them */
	float moved;                   /* by how much this step moved all motors together, as fractions */
	bool standing;                 /* it has not taken off */
	bool thrust;                   /* it has taken off, and the throttle is raised */
};

/* All times in control steps. */
struct plausibility {
	uint32_t wrong_way_after, no_response_after, half_longest; /* limits */
	float smoothing;           /* part of the way that the swinging error's low-pass goes in a step */
	float kept;                /* part of the motors' movement that is left of it after a control step */
	float moved;               /* by them lately, beyond what the errors' moves explain */
	float before[3];           /* rad/s, errors of the step before */
	float period_s;            /* of a control step */
	uint32_t wrong_way[3];     /* steps in a row in which the outputs do not turn the axis towards its setpoint */
	float astray[3];           /* rad, that it has turned too far in those of them in which the error grew */
	uint32_t no_response[3];   /* steps in a row in which a distant axis does not turn towards it */
	float error[3];            /* rad/s, low-passed */
	int side[3];               /* of the setpoint that it last was on by a large error: -1, 1; 0: none yet */
	uint32_t since[3];         /* steps since it came there */
	uint32_t swings[3];        /* changes of side in a row, none later than half_longest after the one before */
};

void plausibility_init(struct plausibility *plausibility, unsigned control_rate_hz);

/* Another flight or another controller begins. */
void plausibility_reset(struct plausibility *plausibility);

/* One control step that flew. Returns what is wrong with the controller, NF_FALLBACK_NONE: nothing. */
enum nf_fallback_cause plausibility_step(struct plausibility *plausibility, const struct plausibility_input *input);
