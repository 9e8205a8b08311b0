#include "hal/stm32f7/core/stop.h"

#include <stdbool.h>
#include <stdint.h>

#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/led.h"
#include "hal/stm32f7/core/motor_pins.h"
#include "hal/stm32f7/core/watchdog.h"

#define FLASH_MS 150u /* lit, then as long dark */
#define PAUSE_MS 900u

/* Is the LED lit at this time of its pattern? */
static bool stop_led_lit(enum led_code code, uint32_t ms)
{
	const uint32_t flashes = (uint32_t)code * 2u * FLASH_MS;
	const uint32_t now = ms % (flashes + PAUSE_MS);

	return now < flashes && now / FLASH_MS % 2u == 0u;
}

/* About a millisecond, by counting instructions: the cycle counter may have failed. */
static void stop_burn_millisecond(void)
{
	const uint32_t hz = clock_is_full_speed() ? CLOCK_CORE_HZ : CLOCK_RESET_HZ;

	for (uint32_t n = hz / 1000u / 4u; n != 0u; --n)
		__asm volatile("nop");
}

_Noreturn void stop(enum led_code code)
{
	interrupts_disable();
	motor_pins_force_low();
	led_start();
	for (uint32_t ms = 0;; ++ms) {
		led_light(stop_led_lit(code, ms));
		watchdog_feed();
		stop_burn_millisecond();
	}
}
