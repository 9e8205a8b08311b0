/* Erasing and programming the flash that holds no code. Runs from ITCM with interrupts masked, for as long as the
 * chip takes: a sector of 16 KB half a second, of 128 KB two, a word 0.1 ms at most. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* As `erase` and `program` of struct flash; false also for a sector with code, for a range that does not lie in one
 * sector without code, and for incomplete words. */
bool flash_memory_erase(void *context, unsigned sector);
bool flash_memory_program(void *context, uint32_t address, const void *words, size_t bytes);
