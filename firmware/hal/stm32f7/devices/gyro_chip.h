/* The gyro chip on SPI1, an MPU6500 or an ICM20689: data-ready at 8 kHz, every n-th edge read by DMA. */
#ifndef STM32F7_GYRO_CHIP_H
#define STM32F7_GYRO_CHIP_H

#include <stdbool.h>
#include <stdint.h>

#include "hal/hal.h"

/* Identifies and configures the chip (takes 0.3 s) and says how it is turned on this board, and which one it is.
 * False: absent, unknown, or it does not keep what is written to it; both are then left alone. Needs the clocks at
 * full speed. */
bool gyro_start(enum board_alignment *alignment, enum gyro_chip *kind);

/* From now on `handlers->sample` gets `rate_hz` samples a second (one of NF_GYRO_RATES_HZ), from interrupts, and
 * `handlers->gyro_silent` is called whenever NF_GYRO_BAD_MS pass without one: also where gyro_start failed. */
void gyro_run(const struct hal_handlers *handlers, unsigned rate_hz);

/* Samples taken so far, wraps at 2^32. */
uint32_t gyro_samples(void);

/* A millisecond has passed. From the tick, which shares the samples' priority. */
void gyro_tick(void);

#endif
