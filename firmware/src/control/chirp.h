/* Chirp: a swept sine on the setpoint of one axis, for the frequency response of the loop. */
#pragma once

#include "nf_contract.h"

enum chirp_state {
	CHIRP_IDLE,    /* the mode is off: switched on in flight, it begins */
	CHIRP_RUNNING,
	CHIRP_SPENT,   /* over, or not allowed when the mode came on: it must go off first */
};

/* The sweep at a control step. A log's record has it as it is. */
struct chirp_sweep {
	enum chirp_state state;
	uint8_t axis;         /* that is excited, or the next one */
	uint8_t controller;   /* that flew when the sweep began */
	uint32_t left;        /* control steps of the sweep, this one included */
	float frequency_hz;   /* of this control step, as all that follows; 0 unless it runs */
	float phase;          /* turns, 0 to 1 */
	float sine;           /* of the phase, -1 to 1 */
	float low;            /* the sine behind a low-pass */
	float added;          /* rad/s, to the setpoint */
};

struct chirp {
	float amplitude;      /* rad/s, at low frequencies */
	float start_hz;
	float growth;         /* part by which the frequency grows in a control step */
	float period_s;       /* of a control step */
	float smoothing;      /* part of the way that `low` goes in a control step */
	float fading;         /* part of `room` that is gone after one */
	uint32_t length;      /* control steps of a sweep */
	struct chirp_sweep sweep;
	float room[3];        /* rad/s, of each axis: errors up to this may come from the chirp */
};

/* Conditions of a control step. */
struct chirp_input {
	bool on;              /* the mode */
	bool allowed;         /* armed, the receiver heard, no failsafe */
	uint8_t controller;   /* that flew last */
};

/* `settings` within their limits; what is needed of them is copied. */
void chirp_init(struct chirp *chirp, const struct nf_settings *settings, unsigned control_rate_hz);

/* One control step: adds to setpoint [rad/s, body] while it runs. Needs to be called only while the mode is on or the state
 * is not CHIRP_IDLE. */
void chirp_step(struct chirp *chirp, const struct chirp_input *input, float setpoint[3]);

/* Returns the axis excited in this control step, or -1. */
int chirp_axis(const struct chirp *chirp);
