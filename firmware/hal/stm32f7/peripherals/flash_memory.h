/* Erasing and programming the flash that holds no code. Runs from ITCM with interrupts masked, for as long as the
 * chip takes: a sector of 16 KB half a second, of 128 KB two, a word 0.1 ms at most. */
#ifndef STM32F7_FLASH_MEMORY_H
#define STM32F7_FLASH_MEMORY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* As `erase` and `program` of struct flash; false also for a sector with code, for a range that does not lie in one
 * sector without code, and for incomplete words. */
bool flash_memory_erase(unsigned sector);
bool flash_memory_program(uint32_t address, const void *words, size_t bytes);

#endif
