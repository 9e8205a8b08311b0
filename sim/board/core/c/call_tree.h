/* Who called whom. */
#ifndef ENGINE_CALL_TREE_H
#define ENGINE_CALL_TREE_H

#include "engine.h"

void profile_block(struct engine *e);
void profile_enter(struct engine *e);

#endif
