/* Who called whom: a tree of functions, each with the instructions executed in it, by watching calls and returns.
 *
 * A block that ends in BL or BLX calls what comes next; arriving at the address behind a call returns from it. A
 * branch into another function, as compilers end one with, puts the new function in the old one's place. */
#include <stdlib.h>

#include "../base/machine.h"
#include "code.h"

#define ROOT 0u
#define NO_NODE 0u /* the root is nobody's child */

static uint32_t profile_child(struct engine *e, uint32_t parent, uint32_t function, uint32_t return_to)
{
	for (uint32_t i = e->nodes[parent].child; i != NO_NODE; i = e->nodes[i].sibling)
		if (e->nodes[i].function == function && e->nodes[i].return_to == return_to)
			return i;
	if (e->node_count == e->node_capacity) {
		const uint32_t capacity = e->node_capacity ? e->node_capacity * 2u : 1024u;
		struct node *const nodes = realloc(e->nodes, capacity * sizeof *nodes);

		if (nodes == NULL)
			return parent;
		e->nodes = nodes;
		e->node_capacity = capacity;
	}
	e->nodes[e->node_count] = (struct node){
		.function = function, .parent = parent, .sibling = e->nodes[parent].child, .return_to = return_to};
	e->nodes[parent].child = e->node_count;
	return e->node_count++;
}

static void profile_plant(struct engine *e)
{
	if (e->node_count != 0u)
		return;
	e->nodes = calloc(1024, sizeof *e->nodes);
	if (e->nodes == NULL) {
		e->profiling = false;
		return;
	}
	e->node_capacity = 1024;
	e->node_count = 1;
	e->nodes[ROOT].return_to = NOWHERE;
	e->s.node = ROOT;
}

/* The nearest caller that waits at `address`; a handler's callers are not looked at. */
static uint32_t profile_returned_to(const struct engine *e, uint32_t address)
{
	for (uint32_t i = e->s.node; i != ROOT && e->nodes[i].return_to != NOWHERE; i = e->nodes[i].parent)
		if (e->nodes[i].return_to == address)
			return e->nodes[i].parent;
	return ROOT;
}

void profile_block(struct engine *e)
{
	struct state *const s = &e->s;
	const uint32_t function = e->function_of[e->block->code];
	const bool jumped = e->s.last_end != e->start;

	profile_plant(e);
	if (!e->profiling)
		return;
	if (s->called != NOWHERE) {
		s->node = profile_child(e, s->node, function, s->called);
	} else if (s->node == ROOT) {
		s->node = profile_child(e, ROOT, function, NOWHERE);
	} else if (jumped && s->last_end != NOWHERE) {
		const uint32_t caller = profile_returned_to(e, e->start);
		const struct node *here = &e->nodes[s->node];

		if (caller != ROOT)
			s->node = caller;
		else if (here->function != function)
			s->node = profile_child(e, here->parent, function, here->return_to);
	}
	s->called = NOWHERE;
}

void profile_enter(struct engine *e)
{
	const uint32_t row = row_of(e->s.pc);

	if (!e->profiling || row == NOWHERE)
		return;
	profile_plant(e);
	e->s.node = profile_child(e, ROOT, e->function_of[row], NOWHERE);
	e->s.called = NOWHERE;
}
