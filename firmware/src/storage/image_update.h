/* Image update: writes the bank that the running image does not run from, and makes the next boot start it.
 *
 * Begin, write in order, end, switch. Until the last word of the switch is written the bank has no number, and the boot
 * part does not start it (storage/image_bank.h). The caller ensures that nothing can arm meanwhile. */
#pragma once

#include "common/sha256.h"
#include "nf_contract.h"
#include "port/flash.h"
#include "storage/image_bank.h"
#include "storage/policy_slots.h"

struct image_update {
	const struct flash *flash;
	char board[NF_IMAGE_BOARD_BYTES]; /* as a header has it */
	unsigned running;                 /* bank */
	/* State of the running update; lost at a restart. */
	bool begun;
	struct nf_image_header header;    /* as it was told */
	uint32_t written;                 /* bytes of the image so far */
};

/* board: at most NF_IMAGE_BOARD_BYTES letters. `flash` outlives `update`. */
void image_update_init(struct image_update *update, const struct flash *flash, unsigned running, const char *board);

/* Begins an update with the image of that header: erases the spare bank. Where that image is under way already, and not
 * switched to, it goes on instead. *offset: where. Waits for the flash, as the next one does.
 * NF_REFUSAL_IMAGE: *why tells what of the header does not fit. NF_REFUSAL_ORDER: the running image has yet to be confirmed,
 * and the spare bank has one that was: the board may have to go back to it. Then nothing is erased. NF_REFUSAL_FLASH. */
enum nf_refusal image_update_begin(struct image_update *update, const struct nf_image_header *header, uint32_t *offset,
				   enum nf_err *why);

/* Writes the image's bytes from `offset` on, in order; both are multiples of 4, `words` is aligned to 4. The last
 * write may be repeated, because its reply may have been lost. NF_REFUSAL_ORDER, NF_REFUSAL_PAYLOAD;
 * NF_REFUSAL_FLASH: the update must be begun anew. */
enum nf_refusal image_update_write(struct image_update *update, uint32_t offset, const void *words, size_t bytes);

/* Has all of it arrived? *crc: of the image as flash has it. May be repeated. NF_REFUSAL_ORDER: bytes are missing.
 * NF_REFUSAL_IMAGE: *why tells NF_ERR_IMAGE_HEADER or _CRC; it has to be begun anew. */
enum nf_refusal image_update_end(struct image_update *update, uint32_t *crc, enum nf_err *why);

/* The SHA-256 of a bank's image, of as many bytes as its header says. NF_OK, or why there is no image. */
enum nf_err image_update_hash(const struct image_update *update, unsigned bank, uint8_t digest[SHA256_BYTES]);

/* Makes the spare bank's image the one that is started from the next boot on, whoever wrote it, if it is whole and has
 * that SHA-256, and a slot holds a policy that it can fly. *sequence: the number that it has then. May be repeated: the number
 * stays as it is. NF_REFUSAL_IMAGE, NF_REFUSAL_BLOB: *why tells what is wrong. NF_REFUSAL_ORDER: it has a number already, and is
 * not started with it: it is older, or has failed; it has to be written anew. NF_REFUSAL_FLASH. */
enum nf_refusal image_update_switch(struct image_update *update, const struct policy_slots *slots,
				    const uint8_t told[SHA256_BYTES], uint32_t *sequence, enum nf_err *why);

/* Do both images count? The spare one is started next, or is the one to go back to should the running one, which has yet to
 * be confirmed, fail. Then each needs its policy, and the slots are left as they are. */
bool image_update_holds_slots(const struct image_update *update);
