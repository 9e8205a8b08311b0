/* Decodes a run of Thumb code. */
#ifndef ENGINE_THUMB_H
#define ENGINE_THUMB_H

#include "engine.h"

/* NULL: no memory. The caller frees it. */
struct block *block_decode(const uint8_t *code, uint32_t size, uint32_t opening);

#endif
