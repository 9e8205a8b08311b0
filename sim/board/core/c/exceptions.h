/* Exceptions of the ARMv7-M core. */
#ifndef ENGINE_EXCEPTIONS_H
#define ENGINE_EXCEPTIONS_H

#include "engine.h"

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

#endif
