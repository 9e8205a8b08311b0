/* What surrounds the network in a control step, forward and backward. */
#ifndef POLICY_H
#define POLICY_H

#include "api.h"
#include "network/c/network.h"

/* What a flight leaves for the backward pass. Rows; T control steps, S samples each. */
struct tape {
	size_t width;      /* n, of the observation */
	size_t by_width;   /* n, padded */
	struct layers layers;
	real *rotor_speed; /* ((T - 1) S + 1, M) [rad/s] */
	real *rate;        /* ((T - 1) S + 1, 3) [rad/s] */
	real *ratio;       /* ((T - 1) S + 1), of voltages, with a battery */
	real *value;       /* (AGE_MAX + T, n): terms before their age, scaled; zero before the first step */
	real *free;        /* (T, 3): 1 where the integral is not held at its limit */
	real *estimate;    /* (T, M) [rad/s], modelled rotor speed */
	real *unclipped;   /* (T, M), outputs before they are clipped */
	real *motors;      /* (T, M), fractions after mix and idle */
	real *command;     /* (T, M), as ESCs decode them */
	real *by_motors;   /* (T, M), derivatives of the loss by motors */
	real *by_value;    /* (T + AGE_MAX, by_width), derivatives by the network's inputs at the step at which they are seen */
	real *notches;     /* ((T - 1) S + 1, 2 harmonics), of notches.c; NULL: there are none */
	real *input;       /* (n), of a step */
	real *passed;      /* (n), of the low-passes */
};

/* ---- mix.c: sim/control/motors.py, from outputs and throttle to motors' fractions and commands ---- */

void mix(const struct plan *p, const real *unclipped, const real *throttle, real *action, real *motors, real *command);
void mix_back(const struct plan *p, const real *unclipped, const real *throttle, const real *by_motors, real *by_action);
void clip_back(const struct plan *p, const real *unclipped, const real *by_action, real *by_unclipped);

/* ---- observation.c: sim/control/observation.py, the network's input ---- */

/* The contract's codes. */
enum {
	BLOCK_RATE = 1,
	BLOCK_ERROR,
	BLOCK_ERROR_DELTA,
	BLOCK_ERROR_INTEGRAL,
	BLOCK_PREVIOUS_ACTION,
	BLOCK_THROTTLE,
	BLOCK_ROTOR_SPEED,
	BLOCK_GRAVITY,
	BLOCK_PREVIOUS_MOTORS,
	BLOCK_ROTOR_ESTIMATE,
	BLOCK_RATE_ESTIMATE,
	BLOCK_RATE_ESTIMATE_ERROR,
	BLOCKS,
};

/* Rows of each block at a control step; or derivatives of the loss by them. */
struct sensed {
	real of[BLOCKS][MOTORS_MAX * LANES];
};

/* What is kept between control steps. */
struct observer {
	real error[3 * LANES], integral[3 * LANES];
};

void observe_error(struct observer *o, const struct controller *c, size_t k, const real *setpoint, struct sensed *s,
		   real *free);
void observe_error_back(struct observer *by, const struct controller *c, size_t k, const real *free, struct sensed *by_s,
			real *by_gyro);
void observe_terms(const struct controller *c, const struct tape *t, size_t k, const struct sensed *s);
void observe_terms_back(const struct controller *c, const struct tape *t, size_t k, struct sensed *by);
const real *observed(const struct controller *c, const struct tape *t, size_t k);

/* ---- estimator.c: sim/control/estimator.py, what a model of the aircraft predicts ---- */

/* Kept between control steps: predicted rates, rows (3); or derivatives by them and by the modelled rotor speeds. */
struct estimates {
	real rate[3 * LANES];
	real rotor_speed[MOTORS_MAX * LANES];
};

void estimate(struct estimates *e, const struct plan *p, const struct tape *t, size_t k, const real *setpoint,
	      const real *throttle, struct sensed *s);
void estimate_back(struct estimates *by, const struct plan *p, const struct tape *t, size_t k, struct sensed *by_s,
		   real *by_gyro);

/* ---- loss.c: the loss of a flight, and its derivatives by rates, outputs and motors ---- */

enum { FIGURE_MAE, FIGURE_MSE, FIGURE_OUTPUT, FIGURE_CHANGE, FIGURE_CLOSED, FIGURES };

/* Figures of each lane. */
struct figures {
	double of[FIGURES][LANES];
};

void loss_add(struct figures *f, const struct plan *p, const struct block *b, const struct tape *t, size_t k,
	      const real *action, const real *action_before);
void loss_sum(const struct figures *f, double *figures);
void loss_back_rate(const struct plan *p, const struct block *b, const struct tape *t, size_t k, real *by_rate);
void loss_back_action(const struct plan *p, const struct block *b, const struct tape *t, size_t k, real *by_action,
		      real *by_motors);

#endif
