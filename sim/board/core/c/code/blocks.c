/* Runs of instructions that unicorn translates as one, kept by where they begin, and how often each was executed. */
#include <stdlib.h>

#include "../base/machine.h"
#include "code.h"

static void blocks_count_one(struct engine *e, struct block *block)
{
	e->enters[block->code] += block->times;
	e->leaves[block->code + block->size / 2u] += block->times;
	block->times = 0;
}

void blocks_count(struct engine *e)
{
	for (uint32_t row = 0; row < e->block_rows; ++row)
		for (struct block *block = e->blocks[row]; block != NULL; block = block->other)
			blocks_count_one(e, block);
}

void blocks_drop(struct engine *e, uint32_t row)
{
	while (e->blocks[row] != NULL) {
		struct block *const block = e->blocks[row];

		e->blocks[row] = block->other;
		free(block);
	}
}

void blocks_forget(struct engine *e)
{
	e->code_changed = false;
	blocks_count(e);
	for (uint32_t row = 0; row < e->block_rows; ++row)
		blocks_drop(e, row);
	uc_ctl_flush_tb(e->uc);
	uc_ctl_flush_tlb(e->uc);
}

void blocks_order(struct engine *e, struct block *block)
{
	block->order = (uint8_t)block_order(host(e, block->start, block->size), block->size, e->to_device + block->code);
	block->device_stores = e->device_stores;
}

struct block *blocks_search(struct engine *e, struct block *before, uint32_t start, uint32_t size, uint32_t opening)
{
	const uint32_t row = row_of(start);

	if (row == NOWHERE)
		return NULL;
	struct block *found = e->blocks[row];

	while (found != NULL && !blocks_is(found, start, size, opening))
		found = found->other;
	if (found == NULL) {
		found = block_decode(host(e, start, size), size, opening);
		if (found == NULL)
			return NULL;
		found->start = start;
		found->code = row;
		blocks_order(e, found);
		found->other = e->blocks[row];
		e->blocks[row] = found;
		if (row >= e->block_rows)
			e->block_rows = row + 1u;
	}
	if (before != NULL)
		before->next = found;
	return found;
}
