/* The ESCs on the motors' lines. */
#ifndef NATIVE_ESC_H
#define NATIVE_ESC_H

#include "native.h"

/* One period more of a channel. Python gets what is no plain frame in whole trains: up to a rest, or as long as a frame
 * can be. */
void esc_show(struct native *n, uint32_t t, uint32_t channel, uint64_t start, uint64_t length, uint32_t high);

#endif
