/* What the program's code says: decoded instructions, how often each was executed, who called whom, what it accesses. */
#ifndef ENGINE_CODE_H
#define ENGINE_CODE_H

#include "../base/engine.h"

/* ---- thumb.c: decodes a run of Thumb code ---- */

/* NULL: no memory. The caller frees it. */
struct block *block_decode(const uint8_t *code, uint32_t size, uint32_t opening);
/* What the instruction at `code` accesses. `room`: bytes that may be looked at. */
struct access thumb_access(const uint8_t *code, uint32_t room);
/* What the first `size` bytes of a run do last. to_device: of each halfword, whether a store there went to a register. */
enum order block_order(const uint8_t *code, uint32_t size, const bool *to_device);
/* Does a DSB follow the instruction at `code` before anything that it must come before: a store, a branch, a change of masks
 * or of the stack? `room`: bytes that may be looked at. */
bool thumb_syncs_next(const uint8_t *code, uint32_t room);

/* ---- blocks.c: runs of instructions that unicorn translates as one, and how often each was executed ---- */

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

/* ---- call_tree.c ---- */

void profile_block(struct engine *e);
void profile_enter(struct engine *e);

/* ---- watch.c: watchpoints of a debugger ---- */

/* Returns whether the instruction at `at`, which is executed next, accesses watched memory; notes it in `watch_hit`. */
bool watch_sees(struct engine *e, uint32_t at);
/* Returns whether an IT block's condition fails for instruction `index` of the running block, which is then skipped. */
bool watch_is_skipped(struct engine *e, uint32_t index);

#endif
