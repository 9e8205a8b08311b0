/* Alarms and SysTick when they are due. */
#ifndef ENGINE_EVENTS_H
#define ENGINE_EVENTS_H

#include "engine.h"

void events_fire(struct engine *e);

#endif
