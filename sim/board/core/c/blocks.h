/* Runs of instructions that unicorn translates as one, and how often each was executed. */
#ifndef ENGINE_BLOCKS_H
#define ENGINE_BLOCKS_H

#include "engine.h"

/* The block that begins at `start`, `before` having run before it; NULL: no code can be there. */
struct block *blocks_find(struct engine *e, struct block *before, uint32_t start, uint32_t size, uint32_t opening);
void blocks_count(struct engine *e); /* counts of blocks in use, into enters and leaves */
void blocks_drop(struct engine *e, uint32_t row);
void blocks_forget(struct engine *e); /* code was changed from outside; not while unicorn runs */

#endif
