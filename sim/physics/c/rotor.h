/* Rotors: motor command to speed, speed to force and moment on the aircraft. */
#ifndef ROTOR_H
#define ROTOR_H

#include "vector.h"

double polynomial_value(const struct polynomial *p, double at);
double rotor_target_speed(const struct propulsion *p, double command);
double rotor_next_speed(const struct propulsion *p, const double *response, double speed, double target);
double rotor_thrust(const struct propulsion *p, double speed);
double rotor_torque(const struct propulsion *p, double speed, double thrust);
void rotor_wrench(const struct propulsion *p, const struct rotors *r, double dt, const double *before, const double *after,
		  const double *velocity, const double *rate, const double *thrust_factor, const double *torque_factor,
		  const double *load_factor, double *wrench);

#endif
