/* The independent watchdog's feeds. Whatever else is written to it is Python's (sim/board/peripherals/iwdg.py). */
#include "watchdog.h"

enum { WATCHDOG_FEED = 0xAAAA };

bool watchdog_feed(struct native *h, uint32_t window, uint32_t offset, uint32_t size, uint32_t value)
{
	struct watchdog *const w = &h->s.watchdog;

	if (window != h->watchdog_window || offset != h->watchdog_offset || size != 4u || value != WATCHDOG_FEED ||
	    w->period == 0u)
		return false;
	const uint64_t due = engine_due(h->e, h->watchdog_alarm), cycle = native_now(h);

	if (due != NEVER && due >= cycle && due - cycle < w->closest)
		w->closest = due - cycle;
	++w->feeds;
	++w->writes;
	w->unlocked = 0;
	engine_set_alarm(h->e, h->watchdog_alarm, cycle + w->period);
	return true;
}

struct watchdog *native_watchdog(struct native *h, uint32_t alarm)
{
	h->watchdog_alarm = alarm;
	h->watchdog_window = UINT32_MAX;
	h->s.watchdog.closest = NEVER;
	return &h->s.watchdog;
}

void native_place_watchdog(struct native *h, uint32_t window, uint32_t offset)
{
	h->watchdog_window = window;
	h->watchdog_offset = offset;
}
