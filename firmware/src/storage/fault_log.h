/* The log of boots and faults: one entry a boot in a sector of flash, appended; begun anew when little room is left.
 *
 * Never at boot: while a sector is erased no frame reaches the motors, and an ESC keeps its last value.
 *
 * A loss of power leaves each entry whole or none. Only when power fails while the log is begun anew, once in some
 * hundred boots, is it lost: boots are then counted anew, and a fault that nobody acknowledged is forgotten. */
#pragma once

#include "nf_contract.h"
#include "port/flash.h"

struct fault_log {
	const struct flash *flash;
	uint32_t boots;             /* this one included */
	bool crowded;               /* room for a few boots only is left: it is to be begun anew */
	bool pending;               /* a fault is not acknowledged: `record`, the newest one */
	struct fault_record record;
	uint32_t boot;              /* the boot that found it */
	uint32_t address;           /* of its entry, 0: flash did not take it */
	bool logged;                /* flash holds this boot's entry, with the fault before it */
};

/* Counts this boot and keeps `record` (NULL: no fault before it). Waits for the flash, a millisecond; at boot, before
 * anything can arm. Flash that does not take it, or has no room, loses the entry, but a fault is pending all the
 * same. */
void fault_log_boot(struct fault_log *log, const struct flash *flash, const struct fault_record *record);

/* Acknowledges all that is pending, the newest first, like fault_log_acknowledge. NF_REFUSAL_FLASH: the rest stays. */
enum nf_refusal fault_log_acknowledge_all(struct fault_log *log);

/* Begins a crowded log anew with this boot's number and the pending fault. Waits for the flash, up to a second, in which
 * motors get no frames; only while nothing can arm. Once a boot, whether flash takes it or not. */
void fault_log_renew(struct fault_log *log);

/* Acknowledges the fault that boot number `boot` found: it is no longer pending, an earlier one may be. Only while
 * nothing can arm. NF_REFUSAL_INDEX: that is not the pending one. NF_REFUSAL_FLASH: pending it stays. */
enum nf_refusal fault_log_acknowledge(struct fault_log *log, uint32_t boot);
