/* Which peripheral an access goes to, and the chip as unicorn sees it. */
#ifndef ENGINE_WINDOWS_H
#define ENGINE_WINDOWS_H

#include "engine.h"

uint32_t windows_read(struct engine *e, uint32_t address, uint32_t size);
void windows_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value);
uc_err windows_map(struct engine *e);

#endif
