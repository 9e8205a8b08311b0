/* Clock tree: HSE 8 MHz, or HSI 16 MHz where the crystal does not start -> PLL 216 MHz, AHB 216, APB1 54, APB2 108;
 * timers of APB2 run at 216 MHz. */
#pragma once

#include <stdbool.h>

#define CLOCK_CRYSTAL_HZ 8000000u /* of every board */
#define CLOCK_RESET_HZ 16000000u /* HSI, until clock_start succeeds */
#define CLOCK_CORE_HZ 216000000u
#define CLOCK_APB1_HZ 54000000u
#define CLOCK_APB2_HZ 108000000u
#define CLOCK_TIM5_HZ 108000000u /* twice APB1, likewise */
#define CLOCK_TIM1_HZ 216000000u /* twice APB2, because APB2 is divided (RM0431 5.2) */

/* Goes to 216 MHz with over-drive and 7 flash wait states, the crystal watched (its failure raises the NMI). A crystal
 * that does not start is done without: then the internal oscillator makes the clock. Needs time_cycles_start. False: a
 * step did not become ready, and the core runs from HSI at 16 MHz. */
bool clock_start(void);

/* Does the crystal make the clock? The internal oscillator is exact to 1 % at room temperature, and to some per cent
 * from frost to heat (data sheet, HSI): enough for serial lines and DShot, not for flying. After clock_start. */
bool clock_is_exact(void);

/* Clocks of the peripherals that any board uses. */
void clock_peripherals(void);

/* Does the core run from the PLL? Valid at any time, also from a fault. */
bool clock_is_full_speed(void);
