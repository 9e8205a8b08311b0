#include "storage/fault_log.h"

#include <string.h>

#include "common/crc32.h"

#define FAULT_LOG_MAGIC 0x4C46464Eu /* "NFFL" */
#define FAULT_LOG_SECTOR 3u

struct entry {
	uint32_t magic;
	uint32_t boot;              /* number of the boot that wrote it */
	struct fault_record record; /* what it found, FAULT_NONE: nothing */
	uint32_t crc;               /* of all before it */
	uint32_t acknowledged;      /* FLASH_ERASED until acknowledged, then 0; else it was cut: not yet */
};

#define ENTRY_COUNT (NF_FLASH_FAULT_RECORD_SIZE / sizeof(struct entry))
#define ROOM 8u /* boots, some of which may end before the log can be begun anew */
_Static_assert(NF_FLASH_FAULT_RECORD_ADDRESS == NF_FLASH_SECTORS_3_ADDRESS, "the sector to erase");
_Static_assert(sizeof(struct entry) % FLASH_WORD_BYTES == 0, "whole words");

static const struct fault_record nothing = { .kind = FAULT_NONE };

static uint32_t fault_log_address_of(unsigned index)
{
	return NF_FLASH_FAULT_RECORD_ADDRESS + index * (uint32_t)sizeof(struct entry);
}

static struct entry fault_log_read(const struct flash *flash, unsigned index)
{
	struct entry entry;

	memcpy(&entry, flash_at(flash, fault_log_address_of(index)), sizeof entry);
	return entry;
}

static bool fault_log_valid(const struct entry *entry)
{
	return entry->magic == FAULT_LOG_MAGIC && crc32_more(0, entry, offsetof(struct entry, crc)) == entry->crc;
}

static bool fault_log_blank(const struct flash *flash, unsigned index)
{
	const uint8_t *at = flash_at(flash, fault_log_address_of(index));
	uint32_t word;

	for (size_t i = 0; i < sizeof(struct entry); i += sizeof word) {
		memcpy(&word, at + i, sizeof word);
		if (word != FLASH_ERASED)
			return false;
	}
	return true;
}

/* The first entry behind all that is written, ENTRY_COUNT: full. */
static unsigned fault_log_first_blank(const struct flash *flash)
{
	unsigned index = ENTRY_COUNT;

	while (index > 0 && fault_log_blank(flash, index - 1))
		--index;
	return index;
}

/* Brings `log` up to date with what flash says. */
static void fault_log_scan(struct fault_log *log, unsigned count)
{
	log->pending = false;
	for (unsigned i = 0; i < count; ++i) {
		const struct entry entry = fault_log_read(log->flash, i);
		if (!fault_log_valid(&entry))
			continue;
		log->boots = entry.boot;
		if (entry.record.kind == FAULT_NONE || entry.acknowledged == 0)
			continue;
		log->pending = true;
		log->record = entry.record;
		log->boot = entry.boot;
		log->address = fault_log_address_of(i);
	}
}

/* Writes what boot number `boot` found as entry number `index`. Returns its address, 0: flash did not take it. */
static uint32_t fault_log_write(const struct fault_log *log, unsigned index, uint32_t boot,
				const struct fault_record *record)
{
	struct entry entry = { .magic = FAULT_LOG_MAGIC, .boot = boot, .record = *record };
	const uint32_t address = fault_log_address_of(index);

	entry.crc = crc32_more(0, &entry, offsetof(struct entry, crc));
	return flash_program(log->flash, address, &entry, offsetof(struct entry, acknowledged)) ? address : 0;
}

void fault_log_boot(struct fault_log *log, const struct flash *flash, const struct fault_record *record)
{
	const unsigned index = fault_log_first_blank(flash);
	const struct fault_record found = record ? *record : nothing;

	*log = (struct fault_log){ .flash = flash };
	fault_log_scan(log, index);
	++log->boots;
	log->crowded = index + ROOM >= ENTRY_COUNT;
	const uint32_t address = index < ENTRY_COUNT ? fault_log_write(log, index, log->boots, &found) : 0;
	log->logged = address != 0;
	if (found.kind == FAULT_NONE)
		return;
	log->pending = true;
	log->record = found;
	log->boot = log->boots;
	log->address = address;
}

void fault_log_renew(struct fault_log *log)
{
	const bool erased = flash_erase(log->flash, FAULT_LOG_SECTOR);
	unsigned index = 0;

	log->crowded = false;
	log->address = 0;
	if (!erased)
		return;
	if (log->pending)
		log->address = fault_log_write(log, index++, log->boot, &log->record);
	if (!log->pending || log->boot != log->boots)
		(void)fault_log_write(log, index, log->boots, &nothing);
}

enum nf_refusal fault_log_acknowledge(struct fault_log *log, uint32_t boot)
{
	static const uint32_t acknowledged = 0;
	const uint32_t boots = log->boots;

	if (!log->pending || log->boot != boot)
		return NF_REFUSAL_INDEX;
	if (log->address && !flash_program(log->flash, log->address + offsetof(struct entry, acknowledged),
					   &acknowledged, sizeof acknowledged))
		return NF_REFUSAL_FLASH;
	fault_log_scan(log, ENTRY_COUNT);
	log->boots = boots; /* also where flash did not take this boot's entry */
	return NF_REFUSAL_NONE;
}

enum nf_refusal fault_log_acknowledge_all(struct fault_log *log)
{
	enum nf_refusal refusal = NF_REFUSAL_NONE;

	for (unsigned i = 0; i < ENTRY_COUNT && log->pending && refusal == NF_REFUSAL_NONE; ++i)
		refusal = fault_log_acknowledge(log, log->boot);
	return refusal;
}
