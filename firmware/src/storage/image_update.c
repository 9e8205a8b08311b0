#include "storage/image_update.h"

#include <string.h>

#define HEADER_MAGIC_OFFSET (NF_IMAGE_HEADER_OFFSET + offsetof(struct nf_image_header, magic))
_Static_assert(sizeof(struct nf_image_header) % FLASH_WORD_BYTES == 0, "no bytes between its fields");

void image_update_init(struct image_update *update, const struct flash *flash, unsigned running, const char *board)
{
	*update = (struct image_update){ .flash = flash, .running = running };
	for (size_t i = 0; i < sizeof update->board && board[i]; ++i)
		update->board[i] = board[i];
}

static unsigned image_update_spare(const struct image_update *update)
{
	return IMAGE_BANK_COUNT - 1u - update->running;
}

static bool image_update_is_header(const struct image_update *update, const struct nf_image_header *header)
{
	return memcmp(header, &update->header, sizeof *header) == 0;
}

/* Gives the update up, and says why. */
static enum nf_refusal image_update_give_up(struct image_update *update, enum nf_refusal why)
{
	update->begun = false;
	return why;
}

/* A power loss during an erase must not leave an image that looks valid or installed by the ROM: the magic is cleared
 * first, and the mark of the writer is written before any byte of the new image. */
static bool image_update_clear(const struct flash *flash, unsigned bank)
{
	static const uint32_t none = 0;
	const struct image_bank_place *place = &image_bank_places[bank];
	const uint32_t magic = image_bank_header(flash, bank).magic;

	if (magic == NF_IMAGE_MAGIC && !flash_program(flash, place->address + HEADER_MAGIC_OFFSET, &none, sizeof none))
		return false;
	return flash_erase(flash, place->sector) && image_bank_claim(flash, bank);
}

/* Is the spare bank's image the one to go back to, should the running one, which has yet to run well, fail? */
static bool image_update_needed(const struct image_update *update)
{
	const unsigned spare = image_update_spare(update);
	const struct image_bank_marks marks = image_bank_marks(update->flash, spare);

	return !image_bank_marks(update->flash, update->running).confirmed && marks.confirmed && !marks.rejected &&
	       image_bank_whole(update->flash, spare, update->board);
}

enum nf_refusal image_update_begin(struct image_update *update, const struct nf_image_header *header, uint32_t *offset,
				   enum nf_err *why)
{
	const unsigned spare = image_update_spare(update);

	*why = image_bank_check(header, spare, update->board);
	if (*why != NF_OK)
		return NF_REFUSAL_IMAGE;
	if (!update->begun || !image_update_is_header(update, header) ||
	    image_bank_marks(update->flash, spare).numbered) {
		if (image_update_needed(update))
			return image_update_give_up(update, NF_REFUSAL_ORDER);
		update->begun = true;
		update->header = *header;
		update->written = 0;
		if (!image_update_clear(update->flash, spare))
			return image_update_give_up(update, NF_REFUSAL_FLASH);
	}
	*offset = update->written;
	return NF_REFUSAL_NONE;
}

enum nf_refusal image_update_write(struct image_update *update, uint32_t offset, const void *words, size_t bytes)
{
	const uint32_t total = update->header.image_bytes;
	const uint32_t address = image_bank_places[image_update_spare(update)].address + offset;

	if (!update->begun)
		return NF_REFUSAL_ORDER;
	if (bytes == 0 || bytes % FLASH_WORD_BYTES || bytes > total || offset > total - bytes)
		return NF_REFUSAL_PAYLOAD;
	if (offset + bytes == update->written && memcmp(flash_at(update->flash, address), words, bytes) == 0)
		return NF_REFUSAL_NONE;
	if (offset != update->written)
		return NF_REFUSAL_ORDER;
	if (!flash_program(update->flash, address, words, bytes))
		return image_update_give_up(update, NF_REFUSAL_FLASH);
	update->written += (uint32_t)bytes;
	return NF_REFUSAL_NONE;
}

enum nf_refusal image_update_end(struct image_update *update, uint32_t *crc, enum nf_err *why)
{
	const unsigned spare = image_update_spare(update);
	const struct nf_image_header header = image_bank_header(update->flash, spare);

	*why = NF_OK;
	if (!update->begun || update->written != update->header.image_bytes)
		return NF_REFUSAL_ORDER;
	if (!image_update_is_header(update, &header))
		*why = NF_ERR_IMAGE_HEADER;
	else if (!image_bank_whole_behind(update->flash, spare, &header, NULL, 0))
		*why = NF_ERR_IMAGE_CRC;
	*crc = header.crc;
	return *why == NF_OK ? NF_REFUSAL_NONE : image_update_give_up(update, NF_REFUSAL_IMAGE);
}

enum nf_err image_update_hash(const struct image_update *update, unsigned bank, uint8_t digest[SHA256_BYTES])
{
	const struct nf_image_header header = image_bank_header(update->flash, bank);
	const enum nf_err err = image_bank_check(&header, bank, update->board);

	if (err == NF_OK)
		sha256(flash_at(update->flash, image_bank_places[bank].address), header.image_bytes, digest);
	return err;
}

/* Is the spare bank's image whole, and the one of that SHA-256? */
static enum nf_err image_update_judge(const struct image_update *update, const uint8_t told[SHA256_BYTES])
{
	const unsigned spare = image_update_spare(update);
	uint8_t digest[SHA256_BYTES];
	const enum nf_err err = image_update_hash(update, spare, digest);

	if (err != NF_OK)
		return err;
	if (!image_bank_whole(update->flash, spare, update->board))
		return NF_ERR_IMAGE_CRC;
	return memcmp(digest, told, sizeof digest) == 0 ? NF_OK : NF_ERR_IMAGE_SHA256;
}

/* Would the next boot start the spare bank's image, as the marks are now? */
static bool image_update_starts(const struct image_update *update)
{
	struct image_bank_marks marks[IMAGE_BANK_COUNT];
	bool good[IMAGE_BANK_COUNT];

	for (unsigned bank = 0; bank < IMAGE_BANK_COUNT; ++bank) {
		const struct nf_image_header header = image_bank_header(update->flash, bank);
		marks[bank] = image_bank_marks(update->flash, bank);
		good[bank] = image_bank_fits(&header, bank, update->board);
	}
	return image_bank_choose(marks, good) == image_update_spare(update);
}

/* Gives the spare bank's image its number, in this order: an image that the ROM has installed, and that has no number yet,
 * would be preferred to any that has one. */
static bool image_update_number(const struct image_update *update)
{
	const struct flash *flash = update->flash;
	const unsigned spare = image_update_spare(update);

	return image_bank_claim(flash, spare) && image_bank_number(flash, update->running) &&
	       image_bank_number(flash, spare);
}

enum nf_refusal image_update_switch(struct image_update *update, const struct policy_slots *slots,
				    const uint8_t told[SHA256_BYTES], uint32_t *sequence, enum nf_err *why)
{
	const unsigned spare = image_update_spare(update);

	*why = image_update_judge(update, told);
	if (*why != NF_OK)
		return NF_REFUSAL_IMAGE;
	*why = policy_slots_for_other_bank(slots);
	if (*why != NF_OK)
		return NF_REFUSAL_BLOB;
	if (!image_bank_marks(update->flash, spare).numbered && !image_update_number(update))
		return NF_REFUSAL_FLASH;
	if (!image_update_starts(update))
		return NF_REFUSAL_ORDER;
	*sequence = image_bank_marks(update->flash, spare).sequence;
	return NF_REFUSAL_NONE;
}

bool image_update_holds_slots(const struct image_update *update)
{
	return image_update_starts(update) || image_update_needed(update);
}
