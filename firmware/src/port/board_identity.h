/* Identity of a board, and what the pilot's settings leave to it. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

/* Constant for a board. */
struct board_identity {
	const char *board;       /* 4 letters, the ecosystem's board identifier */
	const char *target;      /* build target, at most 32 letters */
	const char *maker;       /* 4 letters */
	const char *mcu;         /* the chip's name, at most 32 letters */
	bool osd_chip;           /* a MAX7456 is on the board; this firmware leaves it alone */
	uint32_t unique_id[3];
	float volts_scale;       /* volts at the pack for one at the pin; above 0 */
	float amps_scale;        /* mV at the pin for an ampere; above 0 */
};
