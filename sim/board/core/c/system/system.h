/* The core around its instructions: exceptions, its own registers and counters, and which peripheral an access goes to. */
#ifndef ENGINE_SYSTEM_H
#define ENGINE_SYSTEM_H

#include "../base/engine.h"

/* ---- exceptions.c ---- */

void exceptions_reset(struct engine *e);
void exceptions_pend(struct engine *e, uint32_t exception);
void exceptions_set_line(struct engine *e, uint32_t exception, bool asserted);
uint32_t exceptions_first_pending(const struct engine *e);
uint32_t exceptions_deliverable(struct engine *e); /* EXC_THREAD: none */
bool exceptions_wake(struct engine *e);            /* out of WFI */
void exceptions_enter(struct engine *e, uint32_t exception);
void exceptions_return(struct engine *e, uint32_t exc_return);
void exceptions_raise(struct engine *e, const struct fault *fault);
bool exceptions_preempts(const struct engine *e, uint32_t exception, uint32_t other);
int exceptions_priority(struct engine *e, bool with_primask);

/* ---- counters.c: SysTick, and the cycle counter of the DWT ---- */

void counters_reset(struct engine *e);
void systick_fire(struct engine *e);
bool systick_interrupts(const struct engine *e); /* whether it will, at its end */
uint32_t systick_read(struct engine *e, uint32_t offset); /* from 0xE000E000 */
void systick_write(struct engine *e, uint32_t offset, uint32_t value);
void demcr_write(struct engine *e, uint32_t value);
uint32_t dwt_read(struct engine *e, uint32_t offset); /* from 0xE0001000 */
void dwt_write(struct engine *e, uint32_t offset, uint32_t value);

/* ---- nvic.c: interrupts' enables and priorities, and the MPU; offsets from 0xE000E000 ---- */

bool mpu_closes(const struct engine *e, uint32_t address);
bool mpu_caches(const struct engine *e, uint32_t address); /* the data cache holds what lies there */
uint32_t mpu_read(struct engine *e, uint32_t offset);
void mpu_write(struct engine *e, uint32_t offset, uint32_t value);
uint32_t nvic_read(struct engine *e, uint32_t offset);
void nvic_write(struct engine *e, uint32_t offset, uint32_t value);
uint32_t nvic_priorities(const struct engine *e, uint32_t exception, uint32_t size);
void nvic_set_priorities(struct engine *e, uint32_t exception, uint32_t size, uint32_t value);

/* ---- system_control.c: the core's own registers ---- */

void system_reset_registers(struct engine *e);
uint32_t system_read(struct engine *e, uint32_t address, uint32_t size);
void system_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value);

/* ---- windows.c: which peripheral an access goes to, and the chip as unicorn sees it ---- */

int windows_at(const struct engine *e, uint32_t address); /* number of the window; -1: none */
uint32_t windows_read(struct engine *e, uint32_t address, uint32_t size);
void windows_write(struct engine *e, uint32_t address, uint32_t size, uint32_t value);
uc_err windows_map(struct engine *e);

#endif
