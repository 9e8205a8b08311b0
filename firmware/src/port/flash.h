/* Flash as the core's storage sees it: hal.h's, or a model of it. Addresses and sectors are the contract's. */
#pragma once

#include "nf_contract.h"

#define FLASH_WORD_BYTES 4u /* the least that is programmed, at multiples of itself */
#define FLASH_ERASED 0xFFFFFFFFu /* an erased word */

extern const struct flash_sector {
	uint32_t address;
	uint32_t size;
} flash_sectors[NF_FLASH_SECTORS_COUNT];

/* Its functions are called from the background only, and those that change something only while nothing can arm. */
struct flash {
	void *context;
	/* Reading is memory; what `at` answers stays valid. */
	const uint8_t *(*at)(void *context, uint32_t address);
	/* Sets all bits of a sector. Returns whether they are set. */
	bool (*erase)(void *context, unsigned sector);
	/* Clears bits: `bytes` is a multiple of FLASH_WORD_BYTES, `words` is aligned to it. Returns whether flash then
	 * holds what was asked for. */
	bool (*program)(void *context, uint32_t address, const void *words, size_t bytes);
};

const uint8_t *flash_at(const struct flash *flash, uint32_t address);
bool flash_erase(const struct flash *flash, unsigned sector);
bool flash_program(const struct flash *flash, uint32_t address, const void *words, size_t bytes);
