/* numpy's random numbers: the bits of Generator.standard_normal, from libnpyrandom. */
#ifndef RANDOM_H
#define RANDOM_H

#include <stddef.h>

struct bitgen;

void random_standard_normal_fill(struct bitgen *source, ptrdiff_t count, double *values);

#endif
