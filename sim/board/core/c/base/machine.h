/* The machine under the core: time, registers, memory behind addresses, and how an error is told. */
#ifndef ENGINE_MACHINE_H
#define ENGINE_MACHINE_H

#include "engine.h"

/* ---- clock.c ---- */

uint32_t clock_index_at(const struct engine *e, uint32_t address); /* of an instruction in the block that runs */
uint64_t clock_now(const struct engine *e);         /* time of the instruction at hand */
uint64_t clock_core_cycles(const struct engine *e, uint64_t time);
uint64_t clock_systick_due(const struct engine *e); /* time, NEVER */
void clock_set_core(struct engine *e, uint64_t hz);
void clock_attend(struct engine *e);                /* something changed: decide anew after this instruction */
void clock_alarms_changed(struct engine *e);
uint64_t clock_host_ns(const struct engine *e);     /* of this machine; 0 unless asked for */

/* ---- memory.c ---- */

extern const int general[16]; /* unicorn's names of r0 to pc */

void fail(struct engine *e, const char *format, ...) __attribute__((format(printf, 2, 3)));
uint32_t reg(struct engine *e, int name);
void set_reg(struct engine *e, int name, uint32_t value);
void forget_conditions(uc_engine *uc);
uint8_t *host(struct engine *e, uint32_t address, uint32_t size); /* NULL: not memory */
uint32_t row_of(uint32_t address); /* in CODE_HALFWORDS, NOWHERE: no code */

#endif
