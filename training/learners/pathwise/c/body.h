/* An aircraft that turns about its centre of mass. */
#ifndef BODY_H
#define BODY_H

#include "api.h"
#include "network/c/lanes.h"

void body_turn(const struct plan *p, const real *moment, const real *rate, real *after);
void body_turn_back(const struct plan *p, const real *moment, const real *rate, const real *by_after, real *by_moment,
		    real *by_rate);

#endif
