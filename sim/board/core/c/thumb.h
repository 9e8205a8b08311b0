/* Decodes a run of Thumb code. */
#ifndef ENGINE_THUMB_H
#define ENGINE_THUMB_H

#include "engine.h"

/* NULL: no memory. The caller frees it. */
struct block *block_decode(const uint8_t *code, uint32_t size, uint32_t opening);

/* What the first `size` bytes of a run do last. to_device: of each halfword, whether a store there went to a register. */
enum order block_order(const uint8_t *code, uint32_t size, const bool *to_device);
/* Does a DSB follow the instruction at `code` before anything that it must come before: a store, a branch, a change of masks
 * or of the stack? `room`: bytes that may be looked at. */
bool thumb_syncs_next(const uint8_t *code, uint32_t room);

#endif
