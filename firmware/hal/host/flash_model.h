/* A model of the board's flash: erasing sets a sector's bits, programming clears bits, a word at a time, and power may
 * be cut at any operation. No file and no system call; flash_file.h keeps one across runs. */
#pragma once

#include "nf_contract.h"
#include "port/flash.h"

#define FLASH_MODEL_NEVER UINT32_MAX /* the cut that does not come */

/* State of each word of the interrupted operation after a cut. */
enum flash_cut {
	FLASH_CUT_BEFORE,  /* as it was: the operation had not begun */
	FLASH_CUT_AFTER,   /* as asked for: only what would have come next is missing */
	FLASH_CUT_BETWEEN, /* each bit that was to change did or did not */
	FLASH_CUT_WORDS,   /* some words done, others not */
	FLASH_CUT_NOISE,   /* any bits */
	FLASH_CUT_COUNT,
};

struct flash_model {
	uint8_t *bytes;       /* NF_FLASH_BYTES, 8-byte aligned; outlive the model */
	uint32_t operations;  /* so far: each erase and each programmed word, also those that failed */
	uint32_t cut_at;      /* number of the operation that power goes at, 0 the first; FLASH_MODEL_NEVER */
	enum flash_cut cut;
	uint32_t random;      /* what arbitrary bits are made of; any value but 0 */
	bool dark;            /* power has gone: nothing happens any more */
	unsigned running;     /* bank whose image runs, NF_FLASH_BANKS_COUNT: none. But for the marks at its end it is
				 refused to be changed, and so is the boot part, as the board refuses it */
};

/* A model over `bytes` as they are, power on, no cut to come, nothing running. */
void flash_model_init(struct flash_model *model, uint8_t *bytes);

/* Power will go at the operation `at` from here, 0 being the next. `seed`: of the bits it leaves. */
void flash_model_cut(struct flash_model *model, uint32_t at, enum flash_cut cut, uint32_t seed);

/* As those of struct flash, `context` a flash model; NULL and false where flash does not reach. */
const uint8_t *flash_model_at(void *context, uint32_t address);
bool flash_model_erase(void *context, unsigned sector);
bool flash_model_program(void *context, uint32_t address, const void *words, size_t bytes);

/* `model` for the core; it must outlive what it is handed to. */
struct flash flash_model_interface(struct flash_model *model);
