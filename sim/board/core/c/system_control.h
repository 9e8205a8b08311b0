/* The core's own registers. */
#ifndef ENGINE_SYSTEM_CONTROL_H
#define ENGINE_SYSTEM_CONTROL_H

#include "engine.h"

void system_reset_registers(struct engine *e);
uint32_t system_read(struct engine *e, uint32_t address, uint32_t size);
void system_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value);

#endif
