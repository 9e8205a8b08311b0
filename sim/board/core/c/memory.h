/* Registers of the core, memory behind addresses, and how an error is told. */
#ifndef ENGINE_MEMORY_H
#define ENGINE_MEMORY_H

#include "engine.h"

extern const int general[16]; /* unicorn's names of r0 to pc */

void fail(struct engine *e, const char *format, ...) __attribute__((format(printf, 2, 3)));
uint32_t reg(struct engine *e, int name);
void set_reg(struct engine *e, int name, uint32_t value);
void forget_conditions(uc_engine *uc);
uint8_t *host(struct engine *e, uint32_t address, uint32_t size); /* NULL: not memory */
uint32_t row_of(uint32_t address); /* in CODE_HALFWORDS, NOWHERE: no code */

#endif
