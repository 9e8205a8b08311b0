/* What Python calls and fills in. Read by the C compiler and by cffi.
 *
 * Arrays belong to Python and outlive the structs that point to them; they hold doubles in C order unless said otherwise.
 * N is the number of aircraft, M that of motors. Units are SI; body axes are x forward, y left, z up. A wrench is force and
 * moment at the centre of mass, six numbers in body axes. */

#ifndef API_H
#define API_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { MOTORS_MAX = 16, TERMS_MAX = 8, BATTERY_POINTS_MAX = 32 };

/* ---- rotor.c ---- */

struct polynomial {
	uint32_t terms;
	double term[TERMS_MAX]; /* the constant first */
};

struct propulsion {
	double speed_curve[3];    /* a, b, c of H(u) = a u^2 + b u + c [rad/s] */
	struct polynomial thrust; /* K_T(w) [N s^2/rad^2] */
	struct polynomial torque; /* K_Q(w) [m] */
	double rotor_inertia;     /* [kg m^2] */
	double efficiency;        /* electrical power to power on the shaft */
	bool limited;             /* the rotors' acceleration has limits: see rotor_next_speed */
	double speed_max;         /* [rad/s], where friction takes all of the limited torque; infinite without friction */
	double diameter;          /* [m], of the propeller; the rest is used where rotors have an advance ratio */
	double thrust_advance[2]; /* a1, a2: thrust at an advance ratio J is that at J = 0 times 1 + a1 J + a2 J^2 */
	double torque_advance[2]; /* drag torque likewise */
	double advance_least;     /* J below which both stay as they are there, 0 or less */
	double advance_max;       /* J beyond which both stay as they are there */
};

struct rotors {
	uint32_t motors;
	const double *thrust_wrench;   /* (M, 6) a newton of thrust */
	const double *torque_wrench;   /* (M, 6) a newton metre of drag torque */
	const double *square_wrench;   /* (M, 6) a speed squared, if both coefficients are constants; else NULL */
	const double *reaction_wrench; /* (M, 6) a rad/s^2 */
	const double *motion_wrench;   /* (6M, 6) a speed times a twist, which is velocity and rate */
	const double *inflow;          /* (6, M) speed of each hub along its axis, a twist */
};

void polynomial_values(const struct polynomial *p, size_t count, const double *at, double *value);
void rotor_target_speeds(const struct propulsion *p, size_t count, const double *command, const double *voltage_ratio,
			 double *speed);
void rotor_next_speeds(const struct propulsion *p, size_t count, const double *response, const double *speed,
		       const double *target, double *next);
void rotor_speeds_along(const struct propulsion *p, size_t steps, size_t count, const double *response,
			const double *target, double *speed);
void rotor_loads(const struct propulsion *p, size_t count, const double *speed, double *thrust, double *torque);
void rotor_advance(const struct propulsion *p, const struct rotors *r, size_t count, const double *speed,
		   const double *velocity, const double *rate, double *thrust_factor, double *torque_factor);
void rotor_wrenches(const struct propulsion *p, const struct rotors *r, size_t count, double dt, const double *before,
		    const double *after, const double *velocity, const double *rate, const double *thrust_factor,
		    const double *torque_factor, const double *load_factor, double *wrench);

/* ---- delay.c ---- */

struct delay {
	uint32_t motors;
	uint32_t slots;        /* more than any aircraft's delay */
	uint64_t sample;       /* commands taken so far */
	double *commands;      /* (slots, N, M), of sample k at k modulo slots */
	const int64_t *delays; /* (N) [samples], at least 1 */
};

bool delay_step(struct delay *d, size_t count, const double *command, double *acting);

/* ---- battery.c, supply.c ---- */

struct pack {
	uint32_t points;
	double state_of_charge[BATTERY_POINTS_MAX];
	double voltage[BATTERY_POINTS_MAX]; /* of a rested cell [V], over its charge left */
	double scale;                            /* of the pack's voltage to the cell's */
	double capacity;                         /* [A s] */
	double resistance;                       /* [ohm] */
	double charge_max;                       /* [A s] used, where the voltage is 0 */
};

void pack_open_circuit(const struct pack *p, size_t count, const double *state_of_charge, double *voltage);
void pack_loaded(size_t count, const double *open_circuit, const double *power, double resistance, double *voltage);
void pack_step(const struct pack *p, size_t count, double dt, const double *power, double *charge, double *current,
	       double *voltage);

struct supply {
	uint32_t motors;
	double rate_hz;
	double electronics_power;    /* [W] */
	double bench_voltage;        /* [V], of the supply that the speed curve was measured with; NaN: not known */
	const struct pack *pack;     /* NULL: all are on the bench supply */
	const bool *bench;           /* (N), those on the bench supply beside a pack's */
	const double *torque_factor; /* (N), of the drag torque */
	const double *advance;       /* (N, M), of the drag torque, of rotor_advance; NULL: all 1 */
	double *power;               /* (N) [W], drawn in the last step */
	double *charge;              /* (N) [A s], used */
	double *current;             /* (N) [A] */
	double *pack_voltage;        /* (N) [V], under load */
	double *voltage_ratio;       /* (N), to bench_voltage */
};

void supply_power(const struct supply *s, const struct propulsion *p, size_t count, const double *before,
		  const double *after, double *power);
void supply_step(struct supply *s, const struct propulsion *p, size_t count, const double *before, const double *after);
void supply_update(struct supply *s, size_t count);

/* ---- air.c ---- */

struct wind {
	bool steady;
	void *random;          /* numpy's bitgen_t */
	double mean[3];        /* [m/s], world axes */
	double decay[3];       /* of u, v and w in a sample, for each m/s of airspeed */
	double gain[3];        /* [m/s], standard deviations */
	double axes[9];        /* rows: u, v, w in the world */
	double *draws;         /* (2, N, 3) */
	double *first, *second; /* (N, 3), two lags in a row */
	double *velocity;      /* (N, 3) [m/s] of the air, world axes */
};

void wind_step(struct wind *w, size_t count, const double *airspeed);
void wind_blow(struct wind *w, size_t count);

struct wash {
	void *random;         /* numpy's bitgen_t */
	double turn[4];       /* rows: a step of the band-pass's two states */
	double gain[3];       /* what a step's draws add: the first to both states, the other to the second */
	double root;          /* [(m/s)/sqrt(N)], induced velocity in hover over the root of a rotor's thrust */
	double share;         /* standard deviation of a rotor's thrust over it, in its worst descent */
	double begin, end;    /* sink over induced velocity between which the thrust fluctuates */
	double sideways;      /* velocity across the rotor's axis over the induced one at which it stops */
	double *draws;        /* (2, N, M) */
	double *lag, *noise;  /* (N, M), the band-pass's states; the second, of variance 1, is its output */
};

void wash_step(struct wash *w, size_t count, uint32_t motors);
void wash_shake(const struct wash *w, const struct propulsion *p, size_t count, uint32_t motors, const double *speed,
		const double *velocity, const double *load_factor, double *thrust_factor);

/* ---- sensor.c ---- */

struct sensor {
	void *random;            /* numpy's bitgen_t */
	bool turned, lags, vibrates, saturates;
	double turn[9];          /* rows times it: the body's axes to the chip's */
	double follow;           /* share of the way to its input that the low-pass goes in a sample */
	double noise[3];         /* standard deviation */
	double amplitude[3];     /* of the vibration by one rotor at speed_max, over that of the worst axis */
	double harmonics[2];     /* of it at 2 and 3 times the turns, for 1 at the turns */
	double speed_max;        /* [rad/s] */
	double full_scale;
	const double *factor;    /* (N), of noise */
	const double *shake;     /* (N), vibration of the worst axis */
	double *bias, *lagged;   /* (N, 3) */
	bool *fresh;             /* (N), whose low-pass starts at its next input */
	double *draws;           /* (N, 3) */
};

void sensor_read(struct sensor *s, size_t count, const int64_t *which, const double *value, uint32_t motors,
		 const double *phase, const double *speed, double *reading);

/* ---- bullet.c ---- */

const char *bullet_open(const char *pybullet);
void *bullet_client(void);

/* ---- world.c ---- */

enum { MOUNT_CENTRE, MOUNT_RIG, MOUNT_FREE };

struct world {
	size_t count;
	int mount;
	bool ground, gravity, held;
	double stiffness[3], damping[3]; /* of what holds the rig, about the body axes: [N m/rad], [N m s/rad] */
	void *client;          /* bullet's; NULL: closed */
	int link, frame;       /* of bullet: what torques act on, and the axes that they are given in */
	const int32_t *bodies; /* (N) */
	double half_step;      /* [s] */
	double weight;         /* [N] along world z, of the file's aircraft */
	double axes[9];        /* columns: principal axes */
	double swing[9];       /* rows times it: rate to velocity of the centre of mass, about the pivot */
	double rate_to_torque[9], gyro_torque[27]; /* bullet's torque for a change of rate, for a turning body */
	double arm[3];         /* [m], pivot to centre of mass, body axes */
	double attitude[144];  /* (16, 9): body to world from the squares of bullet's quaternion */
	bool each;             /* the next four are one an aircraft */
	const double *inertia, *inverse; /* ([N,] 3, 3), about the pivot */
	const double *half_push;         /* ([N,] 3, 3), rate gained in half a step by a moment */
	const double *half_gyro;         /* ([N,] 9, 3), and by turning */
	const double *burden;            /* (N, 6), that a wrench is divided by */
	const double *mass_factor;       /* (N) */
	double *inner_rate;              /* (N, 3) [rad/s], bullet's own, body axes */
	double *momentum;                /* (N, 3) [N m s], world axes */
	double *rate, *rotation;         /* (N, 3) body axes; (N, 3, 3) body to world */
	double *velocity, *position;     /* (N, 3), of the centre of mass, world axes */
	double *body_velocity;           /* (N, 3), body axes */
	double *torque, *push, *moment;  /* (N, 3), of the step at hand */
};

bool world_step(struct world *w, const double *wrench);
bool world_read_pose(struct world *w, size_t count, const int64_t *which);

/* ---- twin.c ---- */

enum { STEP_DONE, STEP_BAD_COMMAND, STEP_BULLET_FAILED };

struct twin {
	size_t count;
	double dt, rate_hz;
	double field;               /* specific force at rest [m/s^2] */
	double gravity;             /* [m/s^2], what an accelerometer reads where the centre is held */
	double air_density;         /* [kg/m^3] */
	double drag_area[3];        /* [m^2] */
	const struct propulsion *propulsion;
	const struct rotors *rotors;
	struct delay *delay;
	struct supply *supply;
	struct wind *wind;          /* NULL: calm */
	struct wash *wash;          /* NULL: rotors' thrust does not fluctuate */
	struct world *world;
	struct sensor *gyroscope;   /* NULL: ideal */
	struct sensor *accelerometer; /* NULL: ideal */
	const double *response;     /* (N, 3), of rotor_next_speed */
	const double *speed_factor; /* (N, M) */
	const double *load_factor;  /* (N, 6) */
	double *thrust_factor, *torque_factor; /* (N, M), of rotor_advance and wash_shake; NULL: neither is modelled */
	const double *mass;         /* (N) [kg] */
	const double *command;      /* (N, M), given in this sample */
	double *acting, *before, *target; /* (N, M) */
	double *rotor_speed;        /* (N, M) [rad/s] */
	double *phase;              /* (N, M) [rad]; NULL: nothing vibrates */
	double *air_velocity;       /* (N, 3) [m/s], body axes */
	double *airspeed;           /* (N) [m/s] */
	double *wrench;             /* (N, 6) */
	double *earlier;            /* (N, 3) [m/s], world axes, before the step */
	double *specific_force;     /* (N, 3) [m/s^2], body axes */
	double *gyro, *acceleration; /* (N, 3), readings */
};

int twin_step(struct twin *t);
int twin_run(struct twin *t, size_t samples, double *gyros);
void twin_measure(struct twin *t, size_t count, const int64_t *which);

#endif
