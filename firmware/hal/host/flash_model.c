#include "hal/host/flash_model.h"

#include <string.h>

#define SPREAD 0x9E3779B1u /* an odd number with many bits set, so that neighbouring seeds give different sequences */

void flash_model_init(struct flash_model *model, uint8_t *bytes)
{
	*model = (struct flash_model){
		.bytes = bytes, .cut_at = FLASH_MODEL_NEVER, .random = 1, .running = NF_FLASH_BANKS_COUNT
	};
}

void flash_model_cut(struct flash_model *model, uint32_t at, enum flash_cut cut, uint32_t seed)
{
	model->cut_at = model->operations + at;
	model->cut = cut;
	model->random = (seed + 1) * SPREAD;
	if (model->random == 0)
		model->random = SPREAD;
}

/* Marsaglia's xorshift with the triple 13, 17, 5. */
static uint32_t flash_model_random(struct flash_model *model)
{
	uint32_t x = model->random;

	x ^= x << 13;
	x ^= x >> 17;
	x ^= x << 5;
	model->random = x;
	return x;
}

/* Returns the content of a word after an interrupted operation. */
static uint32_t flash_model_torn(struct flash_model *model, uint32_t before, uint32_t after)
{
	const uint32_t chance = flash_model_random(model);

	switch (model->cut) {
	case FLASH_CUT_AFTER:
		return after;
	case FLASH_CUT_BETWEEN:
		return (before & chance) | (after & ~chance);
	case FLASH_CUT_WORDS:
		return chance >> 31 ? before : after;
	case FLASH_CUT_NOISE:
		return chance;
	case FLASH_CUT_BEFORE:
	case FLASH_CUT_COUNT:
		break;
	}
	return before;
}

/* Counts an operation. Returns whether it completes; *now: power is cut during it. */
static bool flash_model_powered(struct flash_model *model, bool *now)
{
	*now = !model->dark && model->operations == model->cut_at;
	if (*now)
		model->dark = true;
	++model->operations;
	return !model->dark;
}

static void flash_model_change(struct flash_model *model, uint32_t offset, uint32_t after, bool cut)
{
	uint32_t word;

	memcpy(&word, model->bytes + offset, sizeof word);
	word = cut ? flash_model_torn(model, word, after) : after;
	memcpy(model->bytes + offset, &word, sizeof word);
}

/* Would a change of these bytes change what runs? The last `tail` bytes of the bank are none of it. */
static bool flash_model_runs(const struct flash_model *model, uint32_t address, size_t bytes, uint32_t tail)
{
	static const uint32_t banks[NF_FLASH_BANKS_COUNT] = { NF_FLASH_BANK_A_ADDRESS, NF_FLASH_BANK_B_ADDRESS };

	if (model->running >= NF_FLASH_BANKS_COUNT)
		return false;
	const uint32_t begin = banks[model->running], end = begin + NF_FLASH_BANK_A_SIZE - tail;
	return address < NF_FLASH_BOOT_ADDRESS + NF_FLASH_BOOT_SIZE || (address < end && address + bytes > begin);
}

const uint8_t *flash_model_at(void *context, uint32_t address)
{
	const struct flash_model *model = context;
	const uint32_t offset = address - NF_FLASH_BASE;

	return offset < NF_FLASH_BYTES ? model->bytes + offset : NULL;
}

bool flash_model_erase(void *context, unsigned sector)
{
	struct flash_model *model = context;
	bool cut;

	if (sector >= NF_FLASH_SECTORS_COUNT ||
	    flash_model_runs(model, flash_sectors[sector].address, flash_sectors[sector].size, 0))
		return false;
	const bool whole = flash_model_powered(model, &cut);
	const uint32_t begin = flash_sectors[sector].address - NF_FLASH_BASE;
	if (whole || cut)
		for (uint32_t at = 0; at < flash_sectors[sector].size; at += FLASH_WORD_BYTES)
			flash_model_change(model, begin + at, FLASH_ERASED, cut);
	return whole;
}

/* Returns whether the word is then `wanted`. */
static bool flash_model_program_word(struct flash_model *model, uint32_t offset, uint32_t wanted)
{
	uint32_t before;
	bool cut;

	memcpy(&before, model->bytes + offset, sizeof before);
	const bool whole = flash_model_powered(model, &cut);
	if (whole || cut)
		flash_model_change(model, offset, before & wanted, cut);
	return whole && (before & wanted) == wanted;
}

bool flash_model_program(void *context, uint32_t address, const void *words, size_t bytes)
{
	struct flash_model *model = context;
	const uint32_t offset = address - NF_FLASH_BASE;
	bool good = true;

	if (offset % FLASH_WORD_BYTES || bytes % FLASH_WORD_BYTES || offset > NF_FLASH_BYTES ||
	    bytes > NF_FLASH_BYTES - offset || flash_model_runs(model, address, bytes, NF_IMAGE_TAIL_BYTES))
		return false;
	for (uint32_t at = 0; at < bytes; at += FLASH_WORD_BYTES) {
		uint32_t wanted;
		memcpy(&wanted, (const uint8_t *)words + at, sizeof wanted);
		good &= flash_model_program_word(model, offset + at, wanted);
	}
	return good;
}

struct flash flash_model_interface(struct flash_model *model)
{
	return (struct flash){
		.context = model, .at = flash_model_at, .erase = flash_model_erase, .program = flash_model_program
	};
}
