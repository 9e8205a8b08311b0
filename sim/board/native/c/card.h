/* The SD card behind SPI3. */
#ifndef NATIVE_CARD_H
#define NATIVE_CARD_H

#include "native.h"

/* Bytes that begin at `cycle` and last `length` cycles each, answered in place; false: Python is to answer. */
bool card_exchange(struct native *n, uint8_t *bytes, uint32_t count, uint64_t cycle, uint32_t length);

#endif
