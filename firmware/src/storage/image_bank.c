#include "storage/image_bank.h"

#include <string.h>

#include "common/crc32.h"
#include "common/serial_number.h"

#define STATE(bank_address, bank_size) ((bank_address) + (bank_size) - NF_IMAGE_TAIL_BYTES)
#define BYTES_MAX (NF_FLASH_BANK_A_SIZE - NF_IMAGE_TAIL_BYTES)

const struct image_bank_place image_bank_places[IMAGE_BANK_COUNT] = {
	{ NF_FLASH_BANK_A_ADDRESS, STATE(NF_FLASH_BANK_A_ADDRESS, NF_FLASH_BANK_A_SIZE), 5 },
	{ NF_FLASH_BANK_B_ADDRESS, STATE(NF_FLASH_BANK_B_ADDRESS, NF_FLASH_BANK_B_SIZE), 6 },
};
_Static_assert(NF_FLASH_BANK_A_ADDRESS == NF_FLASH_SECTORS_5_ADDRESS, "the sector to erase");
_Static_assert(NF_FLASH_BANK_B_ADDRESS == NF_FLASH_SECTORS_6_ADDRESS, "the sector to erase");
_Static_assert(NF_FLASH_BANK_A_SIZE == NF_FLASH_BANK_B_SIZE, "BYTES_MAX");
_Static_assert(NF_FLASH_BANKS_COUNT == IMAGE_BANK_COUNT, "as the contract has it");
_Static_assert(sizeof(struct nf_image_state) <= NF_IMAGE_TAIL_BYTES, "the state fits");

#define LEAST_BYTES (NF_IMAGE_HEADER_OFFSET + sizeof(struct nf_image_header))

struct nf_image_header image_bank_header(const struct flash *flash, unsigned bank)
{
	struct nf_image_header header;

	memcpy(&header, flash_at(flash, image_bank_places[bank].address + NF_IMAGE_HEADER_OFFSET), sizeof header);
	return header;
}

static struct nf_image_state image_bank_state(const struct flash *flash, unsigned bank)
{
	struct nf_image_state state;

	memcpy(&state, flash_at(flash, image_bank_places[bank].state), sizeof state);
	return state;
}

/* An entry of `numbers`. */
struct number {
	uint32_t sequence;
	uint32_t check; /* its complement */
};
_Static_assert(sizeof(struct number) == NF_IMAGE_NUMBER_WORDS * sizeof(uint32_t), "as the contract has it");

/* Neither erased nor all-zero words pass, nor any of which only some bits were programmed or erased: those have a bit that is
 * the same in both. */
static bool image_bank_holds(const struct number *number)
{
	return number->check == ~number->sequence;
}

static bool image_bank_find_number(const struct nf_image_state *state, struct number *found)
{
	for (size_t i = 0; i < NF_IMAGE_NUMBER_ENTRIES; ++i) {
		memcpy(found, &state->numbers[i * NF_IMAGE_NUMBER_WORDS], sizeof *found);
		if (image_bank_holds(found))
			return true;
	}
	return false;
}

struct image_bank_marks image_bank_marks(const struct flash *flash, unsigned bank)
{
	const struct nf_image_state state = image_bank_state(flash, bank);
	struct image_bank_marks marks = { .rejected = state.rejected == 0 };
	struct number number;

	if (image_bank_find_number(&state, &number)) {
		marks.numbered = true;
		marks.confirmed = state.confirmed == 0;
		marks.sequence = number.sequence;
	}
	marks.installed = state.written == FLASH_ERASED && !marks.numbered;
	for (unsigned i = 0; i < NF_IMAGE_STARTS_MAX; ++i)
		marks.starts += state.starts[i] != FLASH_ERASED;
	return marks;
}

enum nf_err image_bank_check(const struct nf_image_header *header, unsigned bank, const char *board)
{
	if (header->magic != NF_IMAGE_MAGIC)
		return NF_ERR_IMAGE_MAGIC;
	if (header->layout != NF_IMAGE_LAYOUT)
		return NF_ERR_IMAGE_LAYOUT;
	if (memcmp(header->board, board, sizeof header->board) != 0)
		return NF_ERR_IMAGE_BOARD;
	if (header->bank != bank)
		return NF_ERR_IMAGE_BANK;
	if (header->image_bytes < LEAST_BYTES || header->image_bytes > BYTES_MAX ||
	    header->image_bytes % FLASH_WORD_BYTES != 0)
		return NF_ERR_IMAGE_SIZE;
	return NF_OK;
}

bool image_bank_fits(const struct nf_image_header *header, unsigned bank, const char *board)
{
	return image_bank_check(header, bank, board) == NF_OK;
}

bool image_bank_whole_behind(const struct flash *flash, unsigned bank, const struct nf_image_header *header,
			     const void *first, size_t count)
{
	const uint8_t *const image = flash_at(flash, image_bank_places[bank].address);
	uint32_t crc = crc32_more(0, first, count);

	crc = crc32_more(crc, image + count, IMAGE_CRC_OFFSET - count);
	crc = crc32_more(crc, image + IMAGE_CRC_END, header->image_bytes - IMAGE_CRC_END);
	return crc == header->crc;
}

bool image_bank_whole(const struct flash *flash, unsigned bank, const char *board)
{
	const struct nf_image_header header = image_bank_header(flash, bank);

	return image_bank_fits(&header, bank, board) && image_bank_whole_behind(flash, bank, &header, NULL, 0);
}

/* --- Which one is started ----------------------------------------------------------------------------- */
static bool image_bank_startable(const struct image_bank_marks *marks)
{
	return marks->installed || marks->numbered;
}

/* It has had its chances. */
static bool image_bank_failed(const struct image_bank_marks *marks)
{
	return marks->rejected || (!marks->confirmed && marks->starts >= NF_IMAGE_STARTS_MAX);
}

bool image_bank_hopeful(const struct image_bank_marks *marks)
{
	return image_bank_startable(marks) && !image_bank_failed(marks);
}

static bool image_bank_newer(const struct image_bank_marks *a, const struct image_bank_marks *b)
{
	if (a->installed || b->installed)
		return a->installed && !b->installed;
	return serial_number_newer(a->sequence, b->sequence);
}

unsigned image_bank_choose(const struct image_bank_marks marks[IMAGE_BANK_COUNT], const bool good[IMAGE_BANK_COUNT])
{
	const bool a = good[0] && image_bank_startable(&marks[0]), b = good[1] && image_bank_startable(&marks[1]);

	if (!a && !b)
		return IMAGE_BANK_NONE;
	if (!a || !b)
		return a ? 0 : 1;
	const bool a_failed = image_bank_failed(&marks[0]), b_failed = image_bank_failed(&marks[1]);
	if (a_failed != b_failed)
		return a_failed ? 1 : 0;
	return image_bank_newer(&marks[1], &marks[0]) ? 1 : 0;
}

/* --- Marks -------------------------------------------------------------------------------------------- */
/* Makes the word `member` bytes behind the state's begin `value`, if it is not and can be. */
static bool image_bank_mark(const struct flash *flash, unsigned bank, size_t member, uint32_t value)
{
	const uint32_t address = image_bank_places[bank].state + (uint32_t)member;
	uint32_t word;

	memcpy(&word, flash_at(flash, address), sizeof word);
	if (word == value)
		return true;
	return (value & ~word) == 0 && flash_program(flash, address, &value, sizeof value);
}

bool image_bank_claim(const struct flash *flash, unsigned bank)
{
	return image_bank_mark(flash, bank, offsetof(struct nf_image_state, written), 0);
}

bool image_bank_count_start(const struct flash *flash, unsigned bank)
{
	const struct image_bank_marks marks = image_bank_marks(flash, bank);

	if (marks.starts == NF_IMAGE_STARTS_MAX)
		return true;
	return image_bank_mark(flash, bank, offsetof(struct nf_image_state, starts) + marks.starts * sizeof(uint32_t),
			       0);
}

bool image_bank_confirm(const struct flash *flash, unsigned bank)
{
	return image_bank_mark(flash, bank, offsetof(struct nf_image_state, confirmed), 0);
}

bool image_bank_reject(const struct flash *flash, unsigned bank)
{
	return image_bank_mark(flash, bank, offsetof(struct nf_image_state, rejected), 0);
}

/* Can `number` become the entry at `words`, erased or half written with the same number? */
static bool image_bank_takes(const uint32_t *words, const struct number *number)
{
	uint32_t wanted[NF_IMAGE_NUMBER_WORDS];
	bool takes = true;

	memcpy(wanted, number, sizeof wanted);
	for (size_t i = 0; i < NF_IMAGE_NUMBER_WORDS; ++i)
		takes &= (wanted[i] & ~words[i]) == 0;
	return takes;
}

bool image_bank_number(const struct flash *flash, unsigned bank)
{
	const struct nf_image_state state = image_bank_state(flash, bank);
	const struct image_bank_marks other = image_bank_marks(flash, 1 - bank);
	const uint32_t sequence = other.numbered ? other.sequence + 1 : 1;
	const struct number number = { .sequence = sequence, .check = ~sequence };

	if (image_bank_marks(flash, bank).numbered)
		return true;
	for (size_t i = 0; i < NF_IMAGE_NUMBER_ENTRIES; ++i) {
		const size_t first = i * NF_IMAGE_NUMBER_WORDS;
		const uint32_t address = image_bank_places[bank].state +
					 (uint32_t)(offsetof(struct nf_image_state, numbers) +
						    first * sizeof(uint32_t));
		if (image_bank_takes(&state.numbers[first], &number))
			return flash_program(flash, address, &number, sizeof number);
	}
	return false;
}
