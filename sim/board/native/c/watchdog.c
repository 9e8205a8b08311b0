/* The independent watchdog's feeds. Whatever else is written to it is Python's (sim/board/peripherals/iwdg.py). */
#include "peripherals.h"

enum { WATCHDOG_FEED = 0xAAAA };

bool watchdog_feed(struct native *n, uint32_t window, uint32_t offset, uint32_t size, uint32_t value)
{
	struct watchdog *const w = &n->s.watchdog;

	if (window != n->watchdog_window || offset != n->watchdog_offset || size != 4u || value != WATCHDOG_FEED ||
	    w->period == 0u)
		return false;
	const uint64_t due = engine_due(n->e, n->watchdog_alarm), cycle = native_now(n);

	if (due != NEVER && due >= cycle && due - cycle < w->closest)
		w->closest = due - cycle;
	++w->feeds;
	++w->writes;
	w->unlocked = 0;
	engine_set_alarm(n->e, n->watchdog_alarm, cycle + w->period);
	return true;
}

struct watchdog *native_watchdog(struct native *n, uint32_t alarm)
{
	n->watchdog_alarm = alarm;
	n->watchdog_window = UINT32_MAX;
	n->s.watchdog.closest = NEVER;
	return &n->s.watchdog;
}

void native_place_watchdog(struct native *n, uint32_t window, uint32_t offset)
{
	n->watchdog_window = window;
	n->watchdog_offset = offset;
}
