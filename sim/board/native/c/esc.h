/* The ESCs on the motors' lines. */
#ifndef NATIVE_ESC_H
#define NATIVE_ESC_H

#include "native.h"

/* Takes a train for a DShot frame; false: it is none, or Python has to say what is wrong with it. */
bool esc_take(struct native *h, uint32_t t, uint32_t channel, const struct train *train);

#endif
