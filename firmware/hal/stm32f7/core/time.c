#include "hal/stm32f7/core/time.h"

#include "hal/stm32f7/core/core.h"

static volatile uint32_t milliseconds_passed; /* written by time_tick alone */

bool time_cycles_start(void)
{
	DCB_DEMCR |= DCB_DEMCR_TRCENA;
	DWT_LAR = 0xC5ACCE55u; /* unlocks the Cortex-M7's counter (DDI 0403E C1.8, CoreSight) */
	DWT_CYCCNT = 0;
	DWT_CTRL |= DWT_CTRL_CYCCNTENA;
	barrier_instructions();
	const uint32_t before = time_cycles();
	barrier_instructions();
	return time_cycles() != before;
}

void time_delay_ms(uint32_t milliseconds)
{
	const uint32_t start = time_ms(); /* a part of this millisecond has passed: it does not count */

	while (time_ms() - start <= milliseconds)
		wait_for_interrupt(); /* the cycle counter may stand meanwhile */
}

void time_tick_start(uint32_t cycles)
{
	SCB_SHPR3 = (SCB_SHPR3 & ~SCB_SHPR3_PRI_15) | FIELD(SCB_SHPR3_PRI_15, PRIORITY_TICK << 4);
	SYST_RVR = cycles - 1u;
	SYST_CVR = 0;
	SYST_CSR = SYST_CSR_CLKSOURCE | SYST_CSR_TICKINT | SYST_CSR_ENABLE;
}

uint32_t time_ms(void)
{
	return milliseconds_passed;
}

void time_tick(void)
{
	++milliseconds_passed;
}
