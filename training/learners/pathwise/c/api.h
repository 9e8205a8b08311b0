/* What Python calls and fills in. Read by the C compiler and by cffi.
 *
 * A block is LANES aircraft that fly side by side, an episode each. A row holds a number of each of them, lane by lane; an
 * array of shape (T, 3) here is T times 3 rows. Arrays belong to Python and outlive the structs that point to them. T is the
 * number of control steps, S that of gyro samples and physics steps in a control step, M that of motors. Units are SI; body
 * axes are x forward, y left, z up. `real` is float for training and double for tests. */

#ifndef PATHWISE_API_H
#define PATHWISE_API_H

#include "network/c/api.h"

enum {
	MOTORS_MAX = 8,
	POLYNOMIAL_MAX = 8,
	TERMS_MAX = 32,
	POINTS_MAX = 32,
	NOTCHES_MAX = 3,
	AGE_MAX = 16,
};

/* ---- the aircraft as its file says ---- */

struct polynomial {
	uint32_t terms;
	real term[POLYNOMIAL_MAX]; /* the constant first */
};

struct propulsion {
	real speed_curve[3];      /* a, b, c: a command u settles at (a u + b) u + c [rad/s] */
	struct polynomial thrust; /* K_T(w) [N s^2/rad^2] */
	struct polynomial torque; /* K_Q(w) [m] */
	bool limited;             /* acceleration has limits; else of first order */
	real lever[2 * MOTORS_MAX];  /* roll and pitch a newton of each rotor's thrust */
	real drag[MOTORS_MAX];       /* yaw a newton metre of drag torque */
	real reaction[MOTORS_MAX];   /* yaw for a rad/s gained in a sample [N m s/rad] */
	real motion[9 * MOTORS_MAX]; /* moment for rotor speed times body rate: rows by rate */
};

struct body {
	real inertia[9], inverse[9]; /* about the centre of mass */
};

struct pack {
	bool present;
	uint32_t points;
	real left[POINTS_MAX]; /* state of charge */
	real volts[POINTS_MAX]; /* of the rested pack over it, divided by the bench supply's voltage */
	real capacity;          /* [A s] */
	real resistance;        /* [ohm], divided by the square of the bench supply's voltage */
	real amperes;           /* for a watt, at the bench supply's voltage */
	real electronics;       /* [W] */
	real efficiency;
	real rotor_inertia;     /* [kg m^2], over the time of a sample */
};

struct gyro {
	bool turned;
	real turn[9];  /* rows times it: the body's axes to the chip's */
	real follow;   /* share of the way to its input that the low-pass goes in a sample; 1: there is none */
	bool vibrates;
	real amplitude[3]; /* of the vibration, over that of the worst axis */
	real harmonics[2]; /* of it at 2 and 3 times the turns, for 1 at the turns */
	real speed_max;    /* [rad/s] */
	real counts;       /* a rad/s */
	real count_max;
};

/* Notches at the rotors' turns and their multiples, which their ESCs tell. */
struct notch_plan {
	uint32_t harmonics; /* a motor and axis; 0: there are none */
	real damping;       /* 1 / Q */
	real turns;         /* a sample for a rad/s */
	real least, highest; /* turns a sample: limits of the centres */
	real fade;          /* 1 over the width above the least in which a notch fades in */
	real least_gain;    /* tan of the lowest centre */
};

/* ---- the policy and what surrounds it ---- */

enum { MIX_ATTITUDE_FIRST, MIX_CENTRED };
enum { DSHOT_STEPS = 1999 };
enum { ESC_BITS = 9, ESC_PERIOD_MAX = 65280 }; /* of the words of ESCs: bits, and the longest period [us] */

struct term {
	uint32_t block; /* the contract's code */
	uint32_t width;
	uint32_t age;
	real gain;  /* of the low-pass; 0: there is none */
	real scale; /* of the network's input */
};

/* Constants of the model that a policy observes by; see toolchain/policy/model_constants.py. */
struct estimator {
	bool present;
	bool measures; /* its rotors are those that ESCs tell */
	uint32_t delay;
	real speed_curve[3];
	real rise, fall, gain_max, loss_max;
	real correction;
	real turn[3 * MOTORS_MAX], reaction[3 * MOTORS_MAX]; /* (3, M) */
};

struct controller {
	int mix;
	real idle;
	real dt; /* [s], of a control step */
	real integral_max;
	bool sees_rotors; /* the speeds that ESCs tell */
	bool rotors_late; /* those of the sample before */
	bool words;       /* in words of nine bits */
	real rotor_turn;  /* rad/s times the period of an electrical turn [us] */
	uint32_t terms;
	struct term term[TERMS_MAX];
	struct estimator estimator;
	struct network network;
};

struct loss {
	real square, output, change, closed; /* weights */
	real soft;                           /* [deg/s], below which an error counts by its square */
	bool of_motors;                      /* whose change it is: the motors', or the outputs' */
	real change_scale;                   /* of a change in a control step */
};

struct plan {
	size_t steps;     /* T */
	uint32_t samples; /* S */
	uint32_t seen;    /* the last ones of a control step, whose mean the controller sees */
	uint32_t motors;  /* M */
	real dt;          /* [s], of a sample */
	bool rounded;     /* the gyro has counts, and ESCs have steps */
	struct propulsion propulsion;
	struct body body;
	struct pack pack;
	struct gyro gyro;
	struct notch_plan notches;
	struct controller controller;
	struct loss loss;
};

/* ---- a block ---- */

struct block {
	/* rows */
	const real *response;               /* (3), as physics/c/rotor.c takes it */
	const real *speed;                  /* (M), factor of the speed that a command settles at */
	const real *lift, *drag, *light;    /* factors of thrust, drag torque and all moments, over that of inertia */
	const real *load;                   /* factor of the drag torque in the battery's power */
	const real *charge;                 /* state of charge at the start; negative: the bench supply */
	const int32_t *delay;               /* [samples], at least 1 */
	const real *shake;                  /* [rad/s], of the worst axis by one rotor at speed_max, where the gyro vibrates */
	const real *phase;                  /* (M) [rad], of the rotors at the start, where the gyro vibrates */
	const real *setpoint;               /* (T, 3) [rad/s] */
	const real *throttle;               /* (T) */
	const real *disturbance;            /* (T, 3) [N m], moments from outside on an aircraft of the file's inertia; NULL: none */
	const real *absolute, *squared, *effort, *closed; /* (T), shares of the control steps in the batch's means */
	const real *noise;                  /* ((T - 1) S + 1, 3) [rad/s], with the bias */
	const real *parameters;             /* of the network, in the order of Python's */
	real *gradient;                     /* likewise; NULL: only the flight */
	double *figures;                    /* (5): mean |e| and e^2, output, change, closed */
	/* What is flown, for tests; or NULL. */
	real *rate;                         /* ((T - 1) S + 1, 3) [rad/s] */
	real *rotor_speed;                  /* ((T - 1) S + 1, M) [rad/s] */
	real *observation;                  /* (T, n), as the network gets it */
	real *motors;                       /* (T, M), fractions after mix and idle, unrounded */
};

size_t flight_memory(const struct plan *p);
void flight_run(const struct plan *p, const struct block *b, real *memory);

/* ---- motors without a controller, in search of the least error ---- */

/* N steps of plan.dt from the first one that motors can act in. */
struct open_loop {
	size_t steps;        /* N */
	bool squared;        /* whether the sum of e^2 is sought, not that of |e| */
	real middle;         /* share of a step's change of speed that the mean speed of the step has */
	uint32_t iterations;
	real barrier[2];     /* weight of the limits' logarithms in the first and the last iteration, in parts of `scale` */
	/* rows */
	const real *scale;            /* [deg/s], or squared: the error at the start, mean of the axes */
	const real *lowest, *highest; /* [rad/s], speeds that the least and the greatest motor value settle at */
	const real *wanted;           /* (3) [rad/s] */
	const real *rate;             /* (3) [rad/s], at the start */
	const real *rotor_speed;      /* (M) [rad/s], likewise */
	real *decision;               /* (N, M), in 0..1: the start of the search, and what it found */
	real *gradient;               /* (N, M), of the sum that is sought, at its end; NULL: not wanted */
	double *figures;              /* (4, LANES): sums of |e| and e^2 over the steps, of the mean over axes; error at the end; bound */
	real *rate_after;             /* (N, 3) [rad/s], after each step; NULL: not wanted */
	real *speed_after;            /* (N, M) [rad/s], likewise */
};

size_t open_loop_memory(const struct plan *p, const struct open_loop *o);
void open_loop_run(const struct plan *p, const struct block *b, const struct open_loop *o, real *memory);

/* ---- a PID in the place of the policy: training/pid_tuning ---- */

enum { COMMANDS_KEPT = 64 }; /* control steps; no command may act later */

struct pid_trial {
	real p[3], i[3], d[3];  /* motor fractions for one rad/s, rad, rad/s^2; roll, pitch, yaw */
	real integral_max[3];   /* [rad] */
	real smoothing;         /* share of a new derivative that its low-pass takes over in a control step */
	const real *mixer;      /* (M, 3), share of each motor in roll, pitch, yaw; no rows */
	const real *moment;     /* rows (3) [N m], lasting, from outside */
	size_t begin;           /* control step from which on figures count, at least 1 */
};

/* Flies a block with a PID, without a derivative; of the block's arrays it needs those of aircraft, commands and noise.
 * figures: rows (7), means over control steps: |error| of roll, pitch, yaw [rad/s], their squares, and the change of a
 * motor's fraction in a control step. */
void pid_trial_run(const struct plan *p, const struct block *b, const struct pid_trial *trial, real *figures);

#endif
