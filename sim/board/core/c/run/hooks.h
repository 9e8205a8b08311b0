/* What unicorn calls while it runs. */
#ifndef ENGINE_HOOKS_H
#define ENGINE_HOOKS_H

#include "../base/engine.h"

void hooks_account(struct engine *e, uint32_t count); /* the first `count` instructions of the block have been executed */
void hooks_close_itcm(struct engine *e);              /* read-only from its first instruction on */
uc_err hooks_add(struct engine *e);

#endif
