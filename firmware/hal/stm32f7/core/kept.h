/* What outlives a reset at a place that boot part and image both know, of whatever builds they are: the last words of
 * DTCM. After a loss of power they hold anything. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#define KEPT_ENTER_ROM 0x4D4F5221u /* "!ROM" */
#define KEPT_SHOW_CARD 0x44524143u /* "CARD" */
#define KEPT_ARMED 0x444D5241u     /* "ARMD" */

struct kept {
	uint32_t card; /* KEPT_SHOW_CARD: the image is to show its card as a disk; it takes and clears it */
	uint32_t request; /* KEPT_ENTER_ROM: the boot part is to enter the chip's boot loader; it takes and clears it */
	uint32_t steps; /* control steps of this boot, the last's until the image starts */
	uint32_t armed; /* KEPT_ARMED plus `steps`: the motors were armed in that step */
};

extern volatile struct kept kept; /* linker script */

/* Does memory say that the motors were armed when the board was reset? */
static inline bool kept_armed(void)
{
	return kept.armed == KEPT_ARMED + kept.steps;
}
