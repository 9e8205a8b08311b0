/* What stops the program: processor faults, failed assertions, a lost clock. Motors low first, then a record that
 * outlives the reset, then the reset. */
#pragma once

#include "nf_contract.h"

/* For programming errors, not for bad input: ends the program. Any context. */
#define HAL_ASSERT(condition)                                                         \
	do {                                                                          \
		if (!(condition))                                                     \
			fault_assert_failed(__FILE__ + FAULT_FILE_SKIPPED, __LINE__); \
	} while (0)

/* Only the end of a path is kept. */
#define FAULT_FILE_SKIPPED (sizeof __FILE__ > NF_FAULT_FILE_BYTES ? sizeof __FILE__ - NF_FAULT_FILE_BYTES : 0u)

/* `file`: at most NF_FAULT_FILE_BYTES with its 0. */
_Noreturn void fault_assert_failed(const char *file, uint32_t line);

/* Reads the cause of the reset and clears it. Called first. */
void fault_start(void);

/* Control steps since boot, and whether the motors are armed, for the record. From the sample handler. */
void fault_note_steps(uint32_t steps, bool armed);

/* Was this start asked for to show the card, by fault_reset? After fault_start. */
bool fault_shows_card(void);

/* Motors low, then the chip starts anew: the image, as ever or to show its card, or the boot loader in the ROM. */
_Noreturn void fault_reset(enum nf_reboot kind);
