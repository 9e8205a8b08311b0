/* Watchpoints of a debugger. */
#ifndef ENGINE_WATCH_H
#define ENGINE_WATCH_H

#include "engine.h"

/* Whether the instruction at `at`, which is about to be executed, accesses what a watchpoint covers; notes it in `watch_hit`. */
bool watch_sees(struct engine *e, uint32_t at);
/* Whether the condition of an IT block keeps this instruction of the block that runs from being executed. */
bool watch_is_skipped(struct engine *e, uint32_t index);

#endif
