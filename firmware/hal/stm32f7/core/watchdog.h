/* The independent watchdog: resets the board when it is not fed for half a second. It has its own clock. */
#pragma once

#include "hal/stm32f7/core/registers.h"

#define WATCHDOG_FEED 0xAAAAu /* IWDG_KR (RM0431 IWDG) */
#define WATCHDOG_START 0xCCCCu

/* As the chip is reset: 4096 ticks of 8 kHz, 0.5 s. It goes on when watchdog_start follows. */
static inline void watchdog_start_as_reset(void)
{
	DBGMCU_APB1FZ |= DBGMCU_APB1FZ_DBG_IWDG_STOP;
	IWDG_KR = WATCHDOG_START;
}

/* From here on until the next reset. While a debugger halts the core it waits. */
void watchdog_start(void);

/* Harmless before watchdog_start. Any context. */
static inline void watchdog_feed(void)
{
	IWDG_KR = WATCHDOG_FEED;
}
