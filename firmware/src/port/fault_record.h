/* A fault: kept across the reset that follows it, reported over MSP. */
#ifndef NF_FAULT_RECORD_H
#define NF_FAULT_RECORD_H

#include <stdint.h>

enum fault_kind {
	FAULT_NONE,
	FAULT_HARD,     /* a processor fault: registers say where */
	FAULT_ASSERT,   /* `file` and `line` say where */
	FAULT_WATCHDOG, /* nobody fed it; where is not known */
	FAULT_BROWN_OUT,
	FAULT_CLOCK,    /* the crystal failed */
	FAULT_RESET,    /* armed, and none of the above: the reset line was pulled, or a debugger reset the chip */
};

#define FAULT_FILE_BYTES 24

struct fault_record {
	uint32_t kind;                 /* enum fault_kind */
	uint32_t r[4], r12, lr, pc, psr; /* as stacked by the exception */
	uint32_t cfsr, hfsr, mmfar, bfar; /* fault status and address registers (ARMv7-M B3.2) */
	uint32_t sp;
	uint32_t line;                 /* of the assertion; else the exception's number, or BOR_LEV for a brown-out */
	char file[FAULT_FILE_BYTES];   /* end of its path, ended with 0 */
	uint32_t uptime_steps;         /* control steps since boot */
};

#endif
