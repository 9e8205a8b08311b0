/* Watchpoints of a debugger. */
#ifndef ENGINE_WATCH_H
#define ENGINE_WATCH_H

#include "engine.h"

/* Returns whether the instruction at `at`, which is executed next, accesses watched memory; notes it in `watch_hit`. */
bool watch_sees(struct engine *e, uint32_t at);
/* Returns whether an IT block's condition fails for instruction `index` of the running block, which is then skipped. */
bool watch_is_skipped(struct engine *e, uint32_t index);

#endif
