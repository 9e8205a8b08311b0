/* Battery voltage and current at their pins: ADC1 converts both continuously, DMA stores the last conversions. */
#ifndef STM32F7_POWER_H
#define STM32F7_POWER_H

#include "port/hal.h"

void power_start(void);

/* The mean of the last 1.2 ms. Invalid where conversions have not filled that since the last call. Background
 * only. */
void power_read(struct power_sample *power);

#endif
