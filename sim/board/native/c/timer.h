/* The timers. */
#ifndef NATIVE_TIMER_H
#define NATIVE_TIMER_H

#include "native.h"

extern const struct driver timer_driver;

void timer_reset(struct native *n, uint32_t t);
void timer_clocks(struct native *n, uint64_t apb1, uint64_t apb2); /* of timers on these buses, from now on [Hz] */
void timer_sync(struct native *n, uint32_t t);
void timer_plan(struct native *n, uint32_t t); /* the alarm for the next update that an interrupt or a stream waits for */
uint32_t timer_read(struct native *n, uint32_t device, uint32_t word);
void timer_write(struct native *n, uint32_t device, uint32_t word, uint32_t value);

#endif
