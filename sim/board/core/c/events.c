/* Alarms and SysTick when they are due. */
#include "clock.h"
#include "counters.h"
#include "events.h"

void events_fire(struct engine *e)
{
	while (!e->failed && e->next_due <= e->s.time) {
		uint64_t first = clock_systick_due(e);
		uint32_t which = ALARM_MAX;

		for (uint32_t i = 0; i < e->alarm_count; ++i)
			if (e->s.due[i] != NEVER && e->s.due[i] << FRACTION < first) {
				first = e->s.due[i] << FRACTION;
				which = i;
			}
		if (which == ALARM_MAX) {
			systick_fire(e);
		} else {
			e->s.due[which] = NEVER;
			const uint64_t began = clock_host_ns(e);

			e->callbacks.alarm(e->callbacks.user, which);
			e->spent[SPENT_DEVICES] += clock_host_ns(e) - began;
		}
		clock_alarms_changed(e);
	}
}
