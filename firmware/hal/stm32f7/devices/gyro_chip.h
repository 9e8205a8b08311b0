/* The gyro chip on SPI1, an ICM20602 or one of its kin: data-ready at 8 kHz, every n-th edge read by DMA. */
#ifndef STM32F7_GYRO_CHIP_H
#define STM32F7_GYRO_CHIP_H

#include <stdbool.h>
#include <stdint.h>

#include "port/hal.h"

struct gyro_found {
	enum board_alignment alignment; /* how it is turned on this board */
	enum gyro_chip kind;
	uint8_t identity; /* WHO_AM_I, as it was read: also of a chip that is not known; 0xFF where none answers */
};

/* Identifies and configures the chip (takes 0.3 s). False: absent, unknown, or it does not keep what is written to it;
 * `found` is then left alone but for the identity that was read. Needs the clocks at full speed. */
bool gyro_start(struct gyro_found *found);

/* From now on `handlers->sample` gets `rate_hz` samples a second (one of NF_GYRO_RATES_HZ), from interrupts, and
 * `handlers->gyro_silent` is called whenever NF_GYRO_BAD_MS pass without one: also where gyro_start failed. */
void gyro_run(const struct hal_handlers *handlers, unsigned rate_hz);

/* Samples taken so far, wraps at 2^32. */
uint32_t gyro_samples(void);

/* A millisecond has passed. From the tick, which shares the samples' priority. */
void gyro_tick(void);

#endif
