/* The MPU6500 on SPI1: data-ready at 8 kHz, every n-th edge read by DMA. */
#ifndef STM32F7_GYRO_MPU6500_H
#define STM32F7_GYRO_MPU6500_H

#include <stdbool.h>
#include <stdint.h>

#include "hal/hal.h"

/* Identifies and configures the chip (takes 0.2 s). False: absent, another chip, or it does not keep what is
 * written to it; gyro_run must then not be called. Needs the clocks at full speed. */
bool gyro_start(void);

/* From now on `handlers->sample` gets `rate_hz` samples a second (a divider of 8000), from interrupts. */
void gyro_run(const struct hal_handlers *handlers, unsigned rate_hz);

/* Does DMA still read the request? */
bool gyro_busy(void);

#endif
