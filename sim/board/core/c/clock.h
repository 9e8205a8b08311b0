/* Time: where it stands, the clock of the core, and when the next event is due. */
#ifndef ENGINE_CLOCK_H
#define ENGINE_CLOCK_H

#include "engine.h"

uint32_t clock_index_at(const struct engine *e, uint32_t address); /* of an instruction in the block that runs */
uint64_t clock_now(const struct engine *e);         /* time of the instruction at hand */
uint64_t clock_core_cycles(const struct engine *e, uint64_t time);
uint64_t clock_systick_due(const struct engine *e); /* time, NEVER */
void clock_set_core(struct engine *e, uint64_t hz);
void clock_attend(struct engine *e);                /* something changed: decide anew after this instruction */
void clock_alarms_changed(struct engine *e);
uint64_t clock_host_ns(const struct engine *e);     /* of this machine; 0 unless asked for */

#endif
