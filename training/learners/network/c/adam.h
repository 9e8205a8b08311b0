/* Adam's step. */
#ifndef ADAM_H
#define ADAM_H

#include "lanes.h"

void adam_step(const struct adam *adam, uint64_t updates, real *parameters, const real *gradient, size_t count);

#endif
