/* The engine from outside: its state, counts and breakpoints. */
#include <string.h>

#include "../base/machine.h"
#include "../code/code.h"
#include "../system/system.h"

void engine_fail(struct engine *e)
{
	fail(e, "%s", "");
}

const char *engine_message(const struct engine *e)
{
	return e->message;
}

uint32_t engine_pc(const struct engine *e)
{
	return e->failed ? e->last_pc : e->block != NULL ? e->at : e->s.pc;
}

void engine_set_pc(struct engine *e, uint32_t pc)
{
	e->s.pc = pc & ~1u;
	e->s.last_end = NOWHERE;
	e->s.in_rom = false;
}

uint32_t engine_register(struct engine *e, int name)
{
	return reg(e, name);
}

void engine_set_register(struct engine *e, int name, uint32_t value)
{
	set_reg(e, name, value);
}

void *engine_state(struct engine *e)
{
	return &e->s;
}

uint32_t engine_state_bytes(void)
{
	return sizeof(struct state);
}

void engine_restored(struct engine *e)
{
	e->block = NULL;
	e->failed = e->reset_wanted = false;
	e->skip = NOWHERE;
	e->watch_passed = false;
	engine_forget_answers(e);
	blocks_forget(e);
	uc_mem_protect(e->uc, ITCM_BASE, ITCM_BYTES, e->s.itcm_closed ? UC_PROT_READ | UC_PROT_EXEC : UC_PROT_ALL);
	if (e->s.node >= e->node_count)
		e->s.node = 0;
	clock_alarms_changed(e);
}

struct core_counts engine_counts(const struct engine *e)
{
	struct core_counts counts = {
		.instructions = e->s.instructions, .hash = e->s.hash, .depth = e->s.depth, .sleeping = e->s.sleeping};

	for (uint32_t i = 0; i < e->window_count; ++i)
		counts.accesses += e->windows[i].reads + e->windows[i].writes;
	return counts;
}

bool engine_cached(const struct engine *e, uint32_t address)
{
	return mpu_caches(e, address);
}

void engine_bound_entry(struct engine *e, uint32_t exception, uint64_t cycles, const char *name, bool urgent)
{
	if (exception >= EXCEPTION_COUNT)
		return;
	e->entry_bound[exception] = cycles << FRACTION;
	e->bound_name[exception] = name;
	e->urgent[exception] = urgent;
}

void engine_clock(struct engine *e, bool on)
{
	e->clocked = on;
	memset(e->spent, 0, sizeof e->spent);
}

const uint64_t *engine_spent(const struct engine *e)
{
	return e->spent;
}

const struct task *engine_task(const struct engine *e, uint32_t exception)
{
	return &e->s.tasks[exception];
}

uint64_t *engine_enters(struct engine *e)
{
	blocks_count(e);
	return e->enters;
}

uint64_t *engine_leaves(struct engine *e)
{
	blocks_count(e);
	return e->leaves;
}

int engine_set_breakpoints(struct engine *e, const uint32_t *addresses, uint32_t count)
{
	if (count > BREAKPOINT_MAX)
		return -1;
	memcpy(e->breakpoints, addresses, count * sizeof *addresses);
	e->breakpoint_count = count;
	clock_attend(e);
	return 0;
}

void engine_skip_breakpoint(struct engine *e)
{
	e->skip = e->s.pc;
	e->skip_depth = e->s.depth;
}

const struct node *engine_nodes(const struct engine *e, uint32_t *count)
{
	*count = e->node_count;
	return e->nodes;
}
