/* The independent watchdog. */
#ifndef NATIVE_WATCHDOG_H
#define NATIVE_WATCHDOG_H

#include "native.h"

/* Takes a write that feeds the watchdog while it runs; false: it is another write. */
bool watchdog_feed(struct native *n, uint32_t window, uint32_t offset, uint32_t size, uint32_t value);

#endif
