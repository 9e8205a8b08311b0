/* Interrupts' enables and priorities, and the MPU; offsets from 0xE000E000. */
#ifndef ENGINE_NVIC_H
#define ENGINE_NVIC_H

#include "engine.h"

bool mpu_closes(const struct engine *e, uint32_t address);
bool mpu_caches(const struct engine *e, uint32_t address); /* the data cache holds what lies there */
uint32_t mpu_read(struct engine *e, uint32_t offset);
void mpu_write(struct engine *e, uint32_t offset, uint32_t value);
uint32_t nvic_read(struct engine *e, uint32_t offset);
void nvic_write(struct engine *e, uint32_t offset, uint32_t value);
uint32_t nvic_priorities(const struct engine *e, uint32_t exception, uint32_t size);
void nvic_set_priorities(struct engine *e, uint32_t exception, uint32_t size, uint32_t value);

#endif
