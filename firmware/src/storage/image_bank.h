/* The two banks of images: what each holds, which is started, and the marks that the board leaves at a bank's end.
 *
 * Shared by the boot part, which chooses, and the firmware, which writes the bank that it does not run from
 * (storage/image_update.h) and confirms its own. contract/image_format.py has the layout. */
#pragma once

#include "nf_contract.h"
#include "port/flash.h"

#define IMAGE_BANK_COUNT 2u
#define IMAGE_BANK_NONE IMAGE_BANK_COUNT /* as a bank: no bank */

extern const struct image_bank_place {
	uint32_t address; /* the image begins here */
	uint32_t state;   /* struct nf_image_state */
	unsigned sector;
} image_bank_places[IMAGE_BANK_COUNT];

/* Decoded marks of a bank; meaningless if the bank has no image. */
struct image_bank_marks {
	bool installed;     /* by the chip's ROM, and not numbered yet */
	bool numbered;      /* `sequence` counts */
	bool confirmed; /* it has run well: only of a numbered one, for what an interrupted erase leaves is none */
	bool rejected;
	uint32_t sequence; /* serial number (common/serial_number.h) */
	unsigned starts; /* counted ones */
};

/* Where the checksum lies in an image; it does not cover itself. */
#define IMAGE_CRC_OFFSET (NF_IMAGE_HEADER_OFFSET + offsetof(struct nf_image_header, crc))
#define IMAGE_CRC_END (IMAGE_CRC_OFFSET + sizeof(uint32_t))

struct nf_image_header image_bank_header(const struct flash *flash, unsigned bank);
struct image_bank_marks image_bank_marks(const struct flash *flash, unsigned bank);

/* Does the header fit bank and board (NF_IMAGE_BOARD_BYTES, 0s behind the name)? Reads no more than the header. NF_OK,
 * or the first of NF_ERR_IMAGE_MAGIC, _LAYOUT, _BOARD, _BANK, _SIZE. */
enum nf_err image_bank_check(const struct nf_image_header *header, unsigned bank, const char *board);
bool image_bank_fits(const struct nf_image_header *header, unsigned bank, const char *board);

/* Is the image that `header` tells of whole, its first bytes taken from `first`, `count` of them, instead of from flash? Reads all
 * of it: 12 cycles a byte. `header` fits. */
bool image_bank_whole_behind(const struct flash *flash, unsigned bank, const struct nf_image_header *header,
			     const void *first, size_t count);

/* Does the bank hold a whole image for this board? */
bool image_bank_whole(const struct flash *flash, unsigned bank, const char *board);

/* Has the image a number or the ROM's word, and its chances not yet had? */
bool image_bank_hopeful(const struct image_bank_marks *marks);

/* Which bank to start: the image that the ROM has just installed, else the newer number. One that was rejected, or was started
 * NF_IMAGE_STARTS_MAX times without being confirmed, comes behind the other; an image that was
 * written and never given a number is not started. good[]: may it be started at all? IMAGE_BANK_NONE: none. */
unsigned image_bank_choose(const struct image_bank_marks marks[IMAGE_BANK_COUNT], const bool good[IMAGE_BANK_COUNT]);

/* Marks. Each may be repeated after a loss of power; false: flash did not take it. */
/* What the bank holds is the firmware's, not the ROM's: it is not started without a number. */
bool image_bank_claim(const struct flash *flash, unsigned bank);
bool image_bank_count_start(const struct flash *flash, unsigned bank);
bool image_bank_confirm(const struct flash *flash, unsigned bank);
bool image_bank_reject(const struct flash *flash, unsigned bank);

/* Gives the bank's image a number newer than the other bank's, so that it is started from now on; one that has a number keeps
 * it. False: flash did not take it. */
bool image_bank_number(const struct flash *flash, unsigned bank);
