/* Measured time: cycles bound waits, milliseconds serve the background. The control path counts gyro samples
 * instead. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "hal/stm32f7/core/registers.h"

/* Starts the cycle counter. False: it does not count, and no wait would be bounded. */
bool time_cycles_start(void);

/* Core cycles, wraps at 2^32 (19.9 s at 216 MHz). */
static inline uint32_t time_cycles(void)
{
	return DWT_CYCCNT;
}

/* Waits until (*reg & mask) == value, at most `cycles`. Returns whether it became true. */
static inline bool time_wait(const volatile uint32_t *reg, uint32_t mask, uint32_t value, uint32_t cycles)
{
	const uint32_t start = time_cycles();

	do {
		if ((*reg & mask) == value)
			return true;
	} while (time_cycles() - start < cycles);
	return (*reg & mask) == value;
}

/* Sleeps for that long, up to one more; for set-up only, interrupts on, after time_tick_start. Without a tick the
 * watchdog ends it. */
void time_delay_ms(uint32_t milliseconds);

/* Starts the millisecond interrupt; `cycles`: of the core, from here on, in a millisecond. */
void time_tick_start(uint32_t cycles);

/* A millisecond has passed. From its interrupt. */
void time_tick(void);

/* Milliseconds since time_tick_start, wraps at 2^32. */
uint32_t time_ms(void);
