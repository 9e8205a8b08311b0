#include "storage/settings_store.h"

#include <string.h>

#include "common/crc32.h"
#include "common/serial_number.h"
#include "storage/mode_range.h"

#define SETTINGS_MAGIC 0x5350464Eu /* "NFPS" */
#define SETTINGS_LAYOUT 1u

/* Layout of a set at the begin of a sector: header, entries, CRC-32 of both. A setting is identified by the CRC-32 of
 * its name, so that sets of other versions can be read; a setting that changes its kind or unit must change its name. */
struct head {
	uint32_t magic;
	uint32_t layout;
	uint32_t sequence; /* wraps: see serial_number.h */
	uint32_t count;    /* of entries */
};

struct entry {
	uint32_t key;
	uint32_t word; /* of the value; a longer value has an entry a word, keys counting up from its name's */
};

static const struct place {
	uint32_t address;
	unsigned sector;
} places[] = {
	{ NF_FLASH_SETTINGS_0_ADDRESS, 1 },
	{ NF_FLASH_SETTINGS_1_ADDRESS, 2 },
};
_Static_assert(NF_FLASH_SETTINGS_COUNT == 2, "alternately");
_Static_assert(NF_FLASH_SETTINGS_0_ADDRESS == NF_FLASH_SECTORS_1_ADDRESS, "the sector to erase");
_Static_assert(NF_FLASH_SETTINGS_1_ADDRESS == NF_FLASH_SECTORS_2_ADDRESS, "the sector to erase");

/* Words of a whole set. */
#define WORDS_OF(name, ...) sizeof(((struct nf_settings *)0)->name) / sizeof(uint32_t) +
#define ENTRY_COUNT (NF_SETTINGS(WORDS_OF) 0u)
#define COUNT_MAX ((NF_FLASH_SETTINGS_0_SIZE - sizeof(struct head) - sizeof(uint32_t)) / sizeof(struct entry))
_Static_assert(ENTRY_COUNT <= COUNT_MAX, "a sector holds them");

static uint32_t settings_store_key_of(const struct setting *setting)
{
	uint32_t crc = 0;

	for (const char *c = setting->name; *c; ++c)
		crc = crc32_more(crc, c, 1);
	return crc;
}

/* Reads the header at `set`. Returns whether a complete set is stored there. */
static bool settings_store_read_head(const uint8_t *set, struct head *head)
{
	uint32_t told;

	memcpy(head, set, sizeof *head);
	if (head->magic != SETTINGS_MAGIC || head->layout != SETTINGS_LAYOUT || head->count > COUNT_MAX)
		return false;
	const size_t checked = sizeof *head + head->count * sizeof(struct entry);
	memcpy(&told, set + checked, sizeof told);
	return crc32_more(0, set, checked) == told;
}

/* The newest set, NULL if there is none. Tells where it stands, and its head. */
static const uint8_t *settings_store_newest(const struct flash *flash, struct head *head, unsigned *place)
{
	const uint8_t *found = NULL;

	for (unsigned i = 0; i < NF_FLASH_SETTINGS_COUNT; ++i) {
		const uint8_t *set = flash_at(flash, places[i].address);
		struct head other;
		if (!settings_store_read_head(set, &other) ||
		    (found && serial_number_newer(head->sequence, other.sequence)))
			continue;
		*head = other;
		*place = i;
		found = set;
	}
	return found;
}

/* `value` is none that the setting may have. Returns whether nothing is lost by that. */
static bool settings_store_refuse(struct nf_settings *settings, unsigned index, const union setting_value *value)
{
	if (settings_info(index)->kind != SETTING_mode)
		return false; /* the default stays */
	(void)settings_set_whole(settings, index, 0);
	return mode_range_index(mode_range_unpack(value->as_mode).mode) == MODE_COUNT;
}

/* Takes the stored value of the setting `index`, if there is one and it is allowed. *likely: the entry to look at first;
 * left behind the one that was found, where the next setting's stands in a set of the same version. Returns whether nothing
 * is lost of what was stored. */
static bool settings_store_take(struct nf_settings *settings, unsigned index, const uint8_t *entries, uint32_t count,
				uint32_t *likely)
{
	const struct setting *setting = settings_info(index);
	const uint32_t key = settings_store_key_of(setting);
	const size_t words = settings_size(setting) / sizeof(uint32_t);
	union setting_value value;
	uint32_t found = 0;

	for (uint32_t i = 0, at = *likely; i < count && found < words; ++i, ++at) {
		struct entry entry;
		at = at < count ? at : 0;
		memcpy(&entry, entries + at * sizeof entry, sizeof entry);
		if (entry.key != key + found)
			continue;
		memcpy((uint8_t *)&value + sizeof entry.word * found++, &entry.word, sizeof entry.word);
		*likely = at + 1;
	}
	return found < words || settings_set(settings, index, &value) == NF_REFUSAL_NONE ||
	       settings_store_refuse(settings, index, &value);
}

enum settings_loaded settings_load(struct nf_settings *settings, const struct flash *flash)
{
	struct head head;
	unsigned place;
	uint32_t likely = 0;
	bool whole = true;
	const uint8_t *set = settings_store_newest(flash, &head, &place);

	settings_default(settings);
	if (!set)
		return SETTINGS_NONE;
	for (unsigned index = 0; index < NF_SETTING_COUNT; ++index)
		whole &= settings_store_take(settings, index, set + sizeof head, head.count, &likely);
	whole &= settings_conflict(settings) == NF_SETTING_COUNT;
	settings_mend(settings);
	return whole ? SETTINGS_AS_STORED : SETTINGS_MENDED;
}

/* A place in flash that fills up, and the CRC of what it holds. */
struct pen {
	const struct flash *flash;
	uint32_t address;
	uint32_t crc;
};

static bool settings_store_write(struct pen *pen, const void *words, size_t bytes)
{
	const uint32_t address = pen->address;

	pen->crc = crc32_more(pen->crc, words, bytes);
	pen->address += (uint32_t)bytes;
	return flash_program(pen->flash, address, words, bytes);
}

/* The CRC is written last: before that there is no valid set. */
static bool settings_store_write_set(struct pen *pen, const struct head *head, const struct nf_settings *settings)
{
	bool good = settings_store_write(pen, head, sizeof *head);

	for (unsigned index = 0; good && index < NF_SETTING_COUNT; ++index) {
		const struct setting *setting = settings_info(index);
		union setting_value value;
		settings_get(settings, index, &value);
		for (uint32_t word = 0; good && word < settings_size(setting) / sizeof(uint32_t); ++word) {
			struct entry entry = { .key = settings_store_key_of(setting) + word };
			memcpy(&entry.word, (const uint8_t *)&value + word * sizeof entry.word, sizeof entry.word);
			good = settings_store_write(pen, &entry, sizeof entry);
		}
	}
	const uint32_t crc = pen->crc;
	return good && settings_store_write(pen, &crc, sizeof crc);
}

enum nf_refusal settings_save(const struct nf_settings *settings, const struct flash *flash)
{
	struct head head = { 0 };
	unsigned last = NF_FLASH_SETTINGS_COUNT - 1;

	if (settings_conflict(settings) != NF_SETTING_COUNT)
		return NF_REFUSAL_CONFLICT;
	(void)settings_store_newest(flash, &head, &last);
	head = (struct head){ SETTINGS_MAGIC, SETTINGS_LAYOUT, head.sequence + 1, ENTRY_COUNT };
	const struct place *place = &places[(last + 1) % NF_FLASH_SETTINGS_COUNT];
	struct pen pen = { .flash = flash, .address = place->address };

	if (!flash_erase(flash, place->sector) || !settings_store_write_set(&pen, &head, settings) ||
	    !settings_store_read_head(flash_at(flash, place->address), &head))
		return NF_REFUSAL_FLASH;
	return NF_REFUSAL_NONE;
}
