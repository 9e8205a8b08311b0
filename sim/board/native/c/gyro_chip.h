/* The gyro chip behind SPI1. */
#ifndef NATIVE_GYRO_CHIP_H
#define NATIVE_GYRO_CHIP_H

#include "native.h"

void gyro_sample(struct native *n);
void gyro_fall(struct native *n); /* of the data-ready line */
/* Bytes of a transaction, answered in place; false: Python is to answer. */
bool gyro_exchange(struct native *n, uint8_t *bytes, uint32_t count, double hz, uint32_t mode);

#endif
