/* Runs of instructions that unicorn translates as one, and how often each was executed. */
#ifndef ENGINE_BLOCKS_H
#define ENGINE_BLOCKS_H

#include "engine.h"

static inline bool blocks_is(const struct block *block, uint32_t start, uint32_t size, uint32_t opening)
{
	return block != NULL && block->start == start && block->size == size && block->opening == opening;
}

struct block *blocks_search(struct engine *e, struct block *before, uint32_t start, uint32_t size, uint32_t opening);

/* The block that begins at `start`, `before` having run before it; NULL: no code can be there. What followed `before` last is
 * likely to do so again, and lies in this machine's cache. */
static inline struct block *blocks_find(struct engine *e, struct block *before, uint32_t start, uint32_t size, uint32_t opening)
{
	if (before != NULL && blocks_is(before->next, start, size, opening))
		return before->next;
	return blocks_search(e, before, start, size, opening);
}

void blocks_order(struct engine *e, struct block *block);

/* The instruction at hand stores to a register. */
static inline void blocks_note_device_store(struct engine *e)
{
	struct block *const block = e->block;

	if (block == NULL)
		return; /* a bus master */
	bool *const known = &e->to_device[block->code + (e->at - e->start) / 2u];

	e->device_stores += !*known;
	*known = true;
	if (block->device_stores != e->device_stores)
		blocks_order(e, block);
}

void blocks_count(struct engine *e); /* counts of blocks in use, into enters and leaves */
void blocks_drop(struct engine *e, uint32_t row);
void blocks_forget(struct engine *e); /* code was changed from outside; not while unicorn runs */

#endif
