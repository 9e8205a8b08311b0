/* From outputs y and throttle T to motors' fractions u' and commands; sim/control/motors.py. */
#ifndef MIX_H
#define MIX_H

#include "api.h"
#include "network/c/lanes.h"

void mix(const struct plan *p, const real *unclipped, const real *throttle, real *action, real *motors, real *command);
void mix_back(const struct plan *p, const real *unclipped, const real *throttle, const real *by_motors, real *by_action);
void clip_back(const struct plan *p, const real *unclipped, const real *by_action, real *by_unclipped);

#endif
