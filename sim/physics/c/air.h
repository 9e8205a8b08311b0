/* Drag of the body, and wind with the Dryden model's gusts. */
#ifndef AIR_H
#define AIR_H

#include "vector.h"

void air_body_drag(double density, const double *air_velocity, const double *drag_area, double *force);

#endif
