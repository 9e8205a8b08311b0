/* SysTick, and the cycle counter of the DWT. */
#ifndef ENGINE_COUNTERS_H
#define ENGINE_COUNTERS_H

#include "engine.h"

void counters_reset(struct engine *e);
void systick_fire(struct engine *e);
bool systick_interrupts(const struct engine *e); /* whether it will, at its end */
uint32_t systick_read(struct engine *e, uint32_t offset); /* from 0xE000E000 */
void systick_write(struct engine *e, uint32_t offset, uint32_t value);
void demcr_write(struct engine *e, uint32_t value);
uint32_t dwt_read(struct engine *e, uint32_t offset); /* from 0xE0001000 */
void dwt_write(struct engine *e, uint32_t offset, uint32_t value);

#endif
