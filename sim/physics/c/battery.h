/* A LiPo pack: voltage under load from power drawn and charge used. */
#ifndef BATTERY_H
#define BATTERY_H

#include "vector.h"

void pack_draw(const struct pack *p, double dt, double power, double *charge, double *current, double *voltage);

#endif
