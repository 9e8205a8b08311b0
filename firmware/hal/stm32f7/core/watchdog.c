#include "hal/stm32f7/core/watchdog.h"

#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/time.h"

#define UNLOCK 0x5555u /* IWDG_KR (RM0431 IWDG) */

/* LSI is 32 kHz, somewhere from 17 to 47 (data sheet): 0.34 to 0.94 s. */
enum { DIVIDE_BY_32 = 3 }; /* IWDG_PR */
#define LSI_HZ 32000u
#define TIMEOUT_MS 500u
#define RELOAD (LSI_HZ / 32u * TIMEOUT_MS / 1000u)

#define UPDATE_LIMIT (CLOCK_CORE_HZ / 1000u * 20u) /* 20 ms: an update takes five of its prescaled cycles */

void watchdog_start(void)
{
	watchdog_start_as_reset();
	IWDG_KR = UNLOCK;
	IWDG_PR = FIELD(IWDG_PR_PR, DIVIDE_BY_32);
	IWDG_RLR = FIELD(IWDG_RLR_RL, RELOAD);
	/* If the update does not end, the reset values apply: 0.5 s too. */
	(void)time_wait(&IWDG_SR, IWDG_SR_PVU | IWDG_SR_RVU, 0, UPDATE_LIMIT);
	watchdog_feed();
}
