#include "storage/flash_chip/flash_log.h"

#include <string.h>

#include "common/crc32.h"
#include "nf_contract.h"

#define MAGIC 0x474C464Eu /* "NFLG" */
#define TRAILER_BYTES 6u  /* of a page: count, CRC-32 */
#define FAILURES_MAX 4u
#define RESERVED 1u       /* blank blocks that no log takes: `erase` sets its mark there */

enum log_state {
	LOG_NONE,
	LOG_OPEN,
	LOG_ENDING, /* the rest is being written */
	LOG_ENDED,  /* well, but nobody has asked yet */
	LOG_BROKEN, /* the chip took no more: all further bytes are refused */
};
enum task { TASK_SCAN, TASK_NONE, TASK_ERASE, TASK_MEASURE };
enum owner {
	OWNER_NONE,
	OWNER_BAD,     /* reads a block's mark as bad */
	OWNER_SCAN,    /* a block's record */
	OWNER_WHOLE,   /* the record in a mark's second page */
	OWNER_PLACE,   /* programs a record, */
	OWNER_CHECK,   /* which is read back */
	OWNER_SPOIL,   /* marks a block as bad */
	OWNER_WRITER,
	OWNER_ERASER,
	OWNER_NUMBER,  /* reads the record of the log that is measured, */
	OWNER_TRAILER, /* pages' trailers, */
	OWNER_LAST,    /* its last page */
	OWNER_READER,
};
enum stage { STAGE_CLEAR, STAGE_MARK, STAGE_ERASE, STAGE_WHOLE };

_Static_assert((FLASH_RING_BYTES & (FLASH_RING_BYTES - 1u)) == 0u, "counts of bytes wrap with the ring");
_Static_assert(sizeof(struct flash_record) == 16u, "as it lies on the chip");

static bool flash_log_is_written(const struct flash_log *log)
{
	return log->state == LOG_OPEN || log->state == LOG_ENDING;
}

/* Bytes of a log that a page holds. */
static uint32_t flash_log_payload(const struct flash_log *log)
{
	return log->chip.page_bytes - TRAILER_BYTES;
}

/* Bytes of a log that a block holds. */
static uint32_t flash_log_block_bytes(const struct flash_log *log)
{
	return (log->chip.pages - 1u) * flash_log_payload(log);
}

static uint32_t flash_log_next(const struct flash_log *log, uint32_t block)
{
	return block + 1u < log->chip.blocks ? block + 1u : 0u;
}

static void flash_log_set(struct flash_log *log, uint32_t block, enum flash_kind kind)
{
	--log->counts[log->kinds[block]];
	++log->counts[kind];
	log->kinds[block] = (uint8_t)kind;
}

/* Returns the first block of that kind from `block` on; `block` if there is none. */
static uint32_t flash_log_seek(const struct flash_log *log, uint32_t block, enum flash_kind kind)
{
	uint32_t at = block;

	for (uint32_t left = log->chip.blocks; left != 0u; --left, at = flash_log_next(log, at))
		if (log->kinds[at] == kind)
			return at;
	return block;
}

/* May a log begin? */
static bool flash_log_has_room(const struct flash_log *log)
{
	return log->counts[FLASH_BLANK] > RESERVED;
}

/* Reads what that is for: a record, a mark as bad, or the page's trailer into `found`, else the whole page into the ring, for a
 * reader behind the pages that it holds. */
static void flash_log_ask(struct flash_log *log, enum owner owner, uint32_t block, uint32_t page)
{
	const uint32_t page_bytes = log->chip.page_bytes;
	uint32_t column = 0, count = page_bytes;
	uint8_t *bytes = log->ring;

	log->owner = (uint8_t)owner;
	if (owner < OWNER_LAST) {
		bytes = (uint8_t *)&log->found;
		count = owner == OWNER_BAD ? 1u : sizeof log->found;
		if (owner == OWNER_BAD)
			column = page_bytes;
		else if (owner == OWNER_TRAILER)
			column = page_bytes - (count = TRAILER_BYTES);
	} else if (owner == OWNER_READER) {
		bytes += log->held_count * page_bytes;
	}
	flash_chip_read(&log->chip, block * log->chip.pages + page, column, bytes, count);
}

static void flash_log_break(struct flash_log *log, enum nf_log_error error)
{
	if (flash_log_is_written(log))
		log->state = LOG_BROKEN;
	log->error = (uint8_t)error;
}

/* ---- records ---- */

static bool flash_log_is_sound(const struct flash_record *record)
{
	return record->magic == MAGIC && record->crc == crc32_more(0, record, offsetof(struct flash_record, crc));
}

static bool flash_log_is_blank(const void *bytes, size_t count)
{
	const uint8_t *const at = bytes;
	size_t i = 0;

	while (i < count && at[i] == 0xFFu)
		++i;
	return i == count;
}

static void flash_log_place(struct flash_log *log, enum flash_kind kind, uint32_t block, uint32_t page)
{
	log->record = (struct flash_record){
		.magic = MAGIC, .sequence = log->sequence, .kind = (uint16_t)kind, .index = (uint16_t)log->index
	};
	log->record.crc = crc32_more(0, &log->record, offsetof(struct flash_record, crc));
	log->owner = OWNER_PLACE;
	flash_chip_program(&log->chip, block * log->chip.pages + page, 0, sizeof log->record);
}

/* A block that could not be erased or begun is left alone: NAND for good, NOR until all is erased. */
static void flash_log_spoil(struct flash_log *log, uint32_t block)
{
	flash_log_set(log, block, log->chip.nand ? FLASH_BAD : FLASH_VOID);
	if (!log->chip.nand)
		return;
	log->owner = OWNER_SPOIL;
	flash_chip_program(&log->chip, block * log->chip.pages, log->chip.page_bytes, 1);
}

/* ---- at the begin: what is on the chip ---- */

static void flash_log_forget_log(struct flash_log *log)
{
	log->head = FLASH_NO_PAGE;
	log->measured = false;
	log->wanted = FLASH_NO_PAGE;
	log->held_count = 0;
}

static void flash_log_rescan(struct flash_log *log)
{
	flash_log_forget_log(log);
	log->there = false;
	log->owner = OWNER_NONE;
	log->task = TASK_SCAN;
	log->block = 0;
	log->frontier = 0;
	log->marked = 0;
	log->sequence = 0;
	log->foreign = false;
	log->number = 0;
	memset(log->counts, 0, sizeof log->counts);
	memset(log->kinds, FLASH_BLANK, sizeof log->kinds);
}

/* All blocks are known. */
static void flash_log_scanned(struct flash_log *log)
{
	log->foreign = log->sequence == 0u && log->counts[FLASH_VOID] != 0u;
	if (log->sequence != 0u)
		log->frontier = flash_log_seek(log, flash_log_next(log, log->marked), FLASH_BLANK);
	if (log->kinds[log->marked] == FLASH_MARK)
		flash_log_ask(log, OWNER_WHOLE, log->marked, 1);
	else
		log->task = TASK_NONE;
}

/* The block that is scanned: behind the last one those of a log that lies over the chip's end once more, its begin being known
 * then. */
static uint32_t flash_log_scan_place(const struct flash_log *log)
{
	return log->block % log->chip.blocks;
}

/* What the block is that has just been read. `number`: sequence of the log or mark that has begun, 0: not known yet. */
static void flash_log_scan_block(struct flash_log *log, bool well)
{
	const struct flash_record *const found = &log->found;
	enum flash_kind kind = FLASH_VOID;

	if (well && flash_log_is_blank(found, sizeof *found)) {
		kind = FLASH_BLANK;
	} else if (well && flash_log_is_sound(found)) {
		if (found->kind == FLASH_HEAD || found->kind == FLASH_MARK)
			log->number = found->sequence;
		if (found->kind <= FLASH_MARK && (log->number == 0u || log->number == found->sequence))
			kind = (enum flash_kind)found->kind;
		if (found->sequence >= log->sequence) {
			log->sequence = found->sequence;
			log->marked = flash_log_scan_place(log);
		}
	}
	flash_log_set(log, flash_log_scan_place(log), kind);
	++log->block;
}

static void flash_log_scan_on(struct flash_log *log)
{
	const uint32_t block = flash_log_scan_place(log);

	if (log->block >= log->chip.blocks && log->kinds[block] != FLASH_BODY)
		flash_log_scanned(log);
	else
		flash_log_ask(log, log->chip.nand ? OWNER_BAD : OWNER_SCAN, block, 0);
}

/* ---- writing ---- */

/* A page's bytes, from the ring; then their count and CRC. */
static void flash_log_fill_page(struct flash_log *log, uint32_t column, uint8_t *bytes, size_t count)
{
	const uint32_t payload = flash_log_payload(log), at = log->written + column;
	const uint32_t data = payload - column < count ? payload - column : (uint32_t)count;

	for (uint32_t i = 0; i < data; ++i)
		bytes[i] = column + i < log->part ? log->ring[(at + i) % FLASH_RING_BYTES] : 0u;
	if (data == count) {
		log->crc = crc32_more(column == 0u ? 0u : log->crc, bytes, data);
		return;
	}
	bytes[data] = (uint8_t)log->part;
	bytes[data + 1u] = (uint8_t)(log->part >> 8);
	log->crc = crc32_more(column == 0u ? 0u : log->crc, bytes, data + 2u);
	memcpy(bytes + data + 2u, &log->crc, sizeof log->crc);
}

static void flash_log_fill(void *context, uint32_t column, uint8_t *bytes, size_t count)
{
	struct flash_log *const log = context;

	if (log->owner == OWNER_WRITER)
		flash_log_fill_page(log, column, bytes, count);
	else if (log->owner == OWNER_PLACE)
		memcpy(bytes, &log->record, count);
	else
		memset(bytes, 0, count);
}

static void flash_log_write_on(struct flash_log *log)
{
	const uint32_t waits = log->taken - log->written, payload = flash_log_payload(log);

	if (waits == 0u && log->state == LOG_ENDING) {
		log->state = LOG_ENDED;
	} else if (waits < payload && log->state != LOG_ENDING) {
		return;
	} else if (log->page == 0u) {
		if (!flash_log_has_room(log) || log->failures == FAILURES_MAX) {
			flash_log_break(log, NF_LOG_ERROR_WRITE);
			return;
		}
		log->block = flash_log_seek(log, log->frontier, FLASH_BLANK);
		log->sequence += log->index == 0u;
		flash_log_place(log, log->index == 0u ? FLASH_HEAD : FLASH_BODY, log->block, 0);
	} else {
		log->part = waits < payload ? waits : payload;
		log->owner = OWNER_WRITER;
		flash_chip_program(&log->chip, log->block * log->chip.pages + log->page, 0, log->chip.page_bytes);
	}
}

/* ---- erasing ---- */

static void flash_log_erase_end(struct flash_log *log, enum log_answer answer)
{
	log->task = TASK_NONE;
	if (log->asked)
		log->answer = (uint8_t)answer;
	log->asked = false;
	if (answer == LOG_FAILED)
		log->error = NF_LOG_ERROR_WRITE;
}

/* doubtful: what looks blank is erased, too. */
static void flash_log_erase_all(struct flash_log *log, bool doubtful)
{
	flash_log_forget_log(log);
	log->task = TASK_ERASE;
	log->doubtful = doubtful;
	log->failures = 0;
	log->marked = flash_log_seek(log, log->frontier, FLASH_BLANK);
	log->stage = doubtful || log->kinds[log->marked] != FLASH_BLANK ? STAGE_CLEAR : STAGE_MARK;
}

/* The mark cannot be set there. */
static void flash_log_erase_elsewhere(struct flash_log *log)
{
	const uint32_t block = log->marked;

	if (++log->failures == FAILURES_MAX) {
		flash_log_erase_end(log, LOG_FAILED);
		return;
	}
	log->marked = flash_log_next(log, block);
	log->stage = STAGE_CLEAR;
	flash_log_spoil(log, block);
}

static void flash_log_erase_block(struct flash_log *log, uint32_t block)
{
	log->owner = OWNER_ERASER;
	flash_chip_erase(&log->chip, block);
}

static void flash_log_erase_on(struct flash_log *log)
{
	switch ((enum stage)log->stage) {
	case STAGE_CLEAR:
		while (log->kinds[log->marked] == FLASH_BAD)
			log->marked = flash_log_next(log, log->marked);
		flash_log_erase_block(log, log->marked);
		return;
	case STAGE_MARK:
		++log->sequence;
		flash_log_place(log, FLASH_MARK, log->marked, 0);
		return;
	case STAGE_ERASE:
		while (log->block != log->marked && (log->kinds[log->block] == FLASH_BAD ||
						     (log->kinds[log->block] == FLASH_BLANK && !log->doubtful)))
			log->block = flash_log_next(log, log->block);
		if (log->block != log->marked) {
			flash_log_erase_block(log, log->block);
			return;
		}
		log->stage = STAGE_WHOLE;
		/* fall through */
	default:
		flash_log_place(log, FLASH_WHOLE, log->marked, 1);
		return;
	}
}

static void flash_log_erased(struct flash_log *log, bool well)
{
	const uint32_t block = log->stage == STAGE_CLEAR ? log->marked : log->block;

	if (log->stage == STAGE_CLEAR) {
		if (!well) {
			flash_log_erase_elsewhere(log);
			return;
		}
		log->stage = STAGE_MARK;
	} else {
		log->block = flash_log_next(log, block);
	}
	if (well)
		flash_log_set(log, block, FLASH_BLANK);
	else
		flash_log_spoil(log, block);
}

/* A record was programmed, and read back. */
static void flash_log_placed(struct flash_log *log, bool well)
{
	const enum flash_kind kind = (enum flash_kind)log->record.kind;

	switch (kind) {
	case FLASH_WHOLE:
		if (well) {
			log->foreign = false;
			log->error = NF_LOG_ERROR_NONE;
			log->frontier = flash_log_next(log, log->marked);
		}
		flash_log_erase_end(log, well ? LOG_DONE : LOG_FAILED);
		return;
	case FLASH_MARK:
		if (!well) {
			flash_log_erase_elsewhere(log);
			return;
		}
		flash_log_set(log, log->marked, kind);
		log->block = flash_log_next(log, log->marked);
		log->stage = STAGE_ERASE;
		return;
	default:
		log->frontier = flash_log_next(log, log->block);
		if (!well) {
			++log->failures;
			flash_log_spoil(log, log->block);
			return;
		}
		log->failures = 0;
		flash_log_set(log, log->block, kind);
		log->page = 1;
		return;
	}
}

/* ---- reading ---- */

/* Returns the `count`th block behind a log's head that continues it: what could not be begun lies between them. */
static uint32_t flash_log_walk(const struct flash_log *log, uint32_t block, uint32_t count)
{
	while (count != 0u) {
		block = flash_log_next(log, block);
		count -= log->kinds[block] == FLASH_BODY;
	}
	return block;
}

static void flash_log_measure_on(struct flash_log *log)
{
	const uint32_t last = flash_log_walk(log, log->head, log->blocks - 1u);

	if (log->number == 0u)
		flash_log_ask(log, OWNER_NUMBER, log->head, 0);
	else if (log->high - log->low > 1u)
		flash_log_ask(log, OWNER_TRAILER, last, (log->low + log->high) / 2u);
	else
		flash_log_ask(log, OWNER_LAST, last, log->low);
}

/* The first page, which is a record, has no bytes of the log. A page that is torn has none, and was not the first that was
 * filled but by the one before it. */
static void flash_log_measured(struct flash_log *log, bool well)
{
	const uint32_t payload = flash_log_payload(log);
	const uint8_t *const trailer = log->ring + payload;
	uint32_t crc, count = trailer[0] | (uint32_t)trailer[1] << 8, pages = log->low;

	memcpy(&crc, trailer + 2, sizeof crc);
	if (pages != 0u && !(well && count <= payload && crc == crc32_more(0, log->ring, payload + 2u))) {
		--pages;
		count = payload;
	}
	log->bytes = (log->blocks - 1u) * flash_log_block_bytes(log) +
		     (pages == 0u ? 0u : (pages - 1u) * payload + count);
	log->measured = true;
	log->task = TASK_NONE;
}

static void flash_log_measure(struct flash_log *log, uint32_t head)
{
	uint32_t block = head;

	flash_log_forget_log(log);
	log->head = head;
	log->blocks = 1;
	for (;;) {
		block = flash_log_next(log, block);
		if (log->kinds[block] == FLASH_HEAD || log->kinds[block] == FLASH_MARK)
			break;
		log->blocks += log->kinds[block] == FLASH_BODY;
	}
	log->number = 0;
	log->low = 0;
	log->high = log->chip.pages;
	log->task = TASK_MEASURE;
}

/* The page that is asked for, and those behind it in its block, which will most likely be: a peer asks for several pages at once,
 * and none is dropped for a later one while the ring has room for both. */
static void flash_log_read_on(struct flash_log *log)
{
	const uint32_t pages = log->chip.pages, room = FLASH_RING_BYTES / log->chip.page_bytes;

	if (log->wanted - log->held >= room || log->wanted / pages != log->held / pages) {
		log->held = log->wanted;
		log->held_count = 0;
	}
	const uint32_t next = log->held + log->held_count;

	if (log->held_count < room && next / pages == log->wanted / pages)
		flash_log_ask(log, OWNER_READER, 0, next);
}

/* ---- what the chip has done ---- */

static void flash_log_done(struct flash_log *log, bool well)
{
	const enum owner owner = (enum owner)log->owner;

	log->owner = OWNER_NONE;
	switch (owner) {
	case OWNER_BAD:
		if (well && *(const uint8_t *)&log->found != 0xFFu)
			flash_log_set(log, log->block++, FLASH_BAD);
		else
			flash_log_ask(log, OWNER_SCAN, flash_log_scan_place(log), 0);
		return;
	case OWNER_SCAN:
		flash_log_scan_block(log, well);
		return;
	case OWNER_WHOLE:
		log->task = TASK_NONE;
		if (!well || !flash_log_is_sound(&log->found))
			flash_log_erase_all(log, true);
		return;
	case OWNER_PLACE:
		if (well)
			flash_log_ask(log, OWNER_CHECK, 0, log->chip.page);
		else
			flash_log_placed(log, false);
		return;
	case OWNER_CHECK:
		flash_log_placed(log, well && memcmp(&log->found, &log->record, sizeof log->record) == 0);
		return;
	case OWNER_WRITER:
		if (!well) {
			flash_log_break(log, NF_LOG_ERROR_WRITE);
			return;
		}
		log->written += log->part;
		if (++log->page == log->chip.pages) {
			log->page = 0;
			++log->index;
		}
		return;
	case OWNER_ERASER:
		flash_log_erased(log, well);
		return;
	case OWNER_NUMBER:
		log->number = log->found.sequence;
		return;
	case OWNER_TRAILER:
		if (well && flash_log_is_blank(&log->found, TRAILER_BYTES))
			log->high = (log->low + log->high) / 2u;
		else
			log->low = (log->low + log->high) / 2u;
		return;
	case OWNER_LAST:
		flash_log_measured(log, well);
		return;
	case OWNER_READER:
		++log->held_count; /* also what the chip could not mend: a log's reader goes on behind it */
		return;
	default:
		return;
	}
}

/* Takes what the chip has done; returns whether nothing more follows from it. */
static bool flash_log_is_free(struct flash_log *log)
{
	if (log->owner != OWNER_NONE)
		flash_log_done(log, log->chip.outcome == FLASH_DONE);
	return log->owner == OWNER_NONE;
}

/* There is no chip that could be used. */
static void flash_log_lose(struct flash_log *log)
{
	if (log->task == TASK_ERASE)
		flash_log_erase_end(log, LOG_FAILED);
	flash_log_break(log, (enum nf_log_error)log->chip.error);
	flash_log_rescan(log);
}

static void flash_log_step(void *context)
{
	struct flash_log *const log = context;
	struct flash_chip *const chip = &log->chip;

	flash_chip_step(chip);
	if (chip->blocks == 0u) {
		if (log->there)
			flash_log_lose(log);
		return;
	}
	if (!flash_chip_free(chip))
		return;
	if (!log->there) {
		log->there = true;
		log->counts[FLASH_BLANK] = (uint16_t)chip->blocks;
	}
	if (!flash_log_is_free(log))
		return;
	if (flash_log_is_written(log))
		flash_log_write_on(log);
	else if (log->task == TASK_SCAN)
		flash_log_scan_on(log);
	else if (log->task == TASK_ERASE)
		flash_log_erase_on(log);
	else if (log->task == TASK_MEASURE)
		flash_log_measure_on(log);
	else if (log->wanted != FLASH_NO_PAGE)
		flash_log_read_on(log);
	flash_chip_step(chip); /* so that one round a millisecond is a page a millisecond */
}

/* ---- as a device ---- */

static uint8_t flash_log_state(const struct flash_log *log)
{
	if (log->chip.blocks == 0u) {
		if (log->chip.error == NF_LOG_ERROR_NONE)
			return NF_LOG_STATE_STARTING;
		return log->chip.error == NF_LOG_ERROR_NO_CARD ? NF_LOG_STATE_ABSENT : NF_LOG_STATE_FAULT;
	}
	if (log->state == LOG_OPEN)
		return log->left == 0u ? NF_LOG_STATE_FULL : NF_LOG_STATE_LOGGING;
	if (flash_log_is_written(log))
		return NF_LOG_STATE_ENDING;
	if (log->task == TASK_SCAN || log->task == TASK_ERASE)
		return NF_LOG_STATE_STARTING;
	if (log->state == LOG_BROKEN || log->foreign || log->failures == FAILURES_MAX)
		return NF_LOG_STATE_FAULT;
	return flash_log_has_room(log) ? NF_LOG_STATE_READY : NF_LOG_STATE_FULL;
}

static uint32_t flash_log_free_blocks(const struct flash_log *log)
{
	return flash_log_has_room(log) ? log->counts[FLASH_BLANK] - RESERVED : 0u;
}

static void flash_log_status(void *context, struct log_device_status *status)
{
	const struct flash_log *const log = context;
	const uint32_t blocks = log->chip.blocks - log->counts[FLASH_BAD], kb = flash_log_block_bytes(log) / 16u;

	*status = (struct log_device_status){ .state = flash_log_state(log), .error = log->error };
	if (status->error == NF_LOG_ERROR_NONE)
		status->error = log->foreign ? NF_LOG_ERROR_FOREIGN : log->chip.error;
	if (log->chip.blocks == 0u)
		return;
	status->looking = log->task == TASK_SCAN;
	status->logs = log->counts[FLASH_HEAD];
	status->empty = (uint16_t)flash_log_free_blocks(log);
	status->capacity_kb = (blocks - RESERVED) * kb / 64u;
	status->free_kb = status->looking || log->foreign ? 0u : flash_log_free_blocks(log) * kb / 64u;
}

static enum log_answer flash_log_begin(void *context)
{
	struct flash_log *const log = context;
	const uint8_t state = flash_log_state(log);

	if (state == NF_LOG_STATE_STARTING || log->owner != OWNER_NONE)
		return LOG_LATER;
	if (state != NF_LOG_STATE_READY)
		return LOG_FAILED;
	flash_log_forget_log(log);
	log->task = TASK_NONE;
	log->page = 0;
	log->index = 0;
	log->taken = 0;
	log->written = 0;
	log->left = flash_log_free_blocks(log) * flash_log_block_bytes(log);
	log->error = NF_LOG_ERROR_NONE;
	log->state = LOG_OPEN;
	return LOG_DONE;
}

static size_t flash_log_write(void *context, const uint8_t *bytes, size_t count)
{
	struct flash_log *const log = context;

	if (log->state != LOG_OPEN)
		return 0;
	const uint32_t room = FLASH_RING_BYTES - (log->taken - log->written);
	const uint32_t limit = room < log->left ? room : log->left, all = count < limit ? (uint32_t)count : limit;
	const uint32_t at = log->taken % FLASH_RING_BYTES, before_end = FLASH_RING_BYTES - at;
	const uint32_t first = all < before_end ? all : before_end;

	memcpy(log->ring + at, bytes, first);
	memcpy(log->ring, bytes + first, all - first);
	log->taken += all;
	log->left -= all;
	return all;
}

static enum log_answer flash_log_end(void *context)
{
	struct flash_log *const log = context;
	const uint8_t state = log->state;

	if (flash_log_is_written(log)) {
		log->state = LOG_ENDING;
		return LOG_LATER;
	}
	log->state = LOG_NONE;
	return state == LOG_ENDED ? LOG_DONE : LOG_FAILED;
}

/* Makes the log `index` the one that is known, by its age; LOG_DONE: it is. */
static enum log_answer flash_log_find(struct flash_log *log, unsigned index)
{
	uint32_t block = log->frontier;

	if (flash_log_is_written(log) || log->chip.blocks == 0u || index >= log->counts[FLASH_HEAD])
		return LOG_FAILED;
	if (log->task != TASK_NONE || log->owner == OWNER_SPOIL)
		return LOG_LATER;
	for (;; block = flash_log_next(log, block))
		if (log->kinds[block] == FLASH_HEAD && index-- == 0u)
			break;
	if (log->head == block && log->measured)
		return LOG_DONE;
	if (log->owner == OWNER_NONE)
		flash_log_measure(log, block);
	log->wanted = FLASH_NO_PAGE;
	return LOG_LATER;
}

static enum log_answer flash_log_entry(void *context, unsigned index, struct log_entry *entry)
{
	struct flash_log *const log = context;
	const enum log_answer answer = flash_log_find(log, index);
	const size_t prefix = sizeof NF_LOG_FILE_PREFIX - 1u;

	if (answer != LOG_DONE)
		return answer;
	*entry = (struct log_entry){ .name = NF_LOG_FILE_PREFIX "00000" NF_LOG_FILE_SUFFIX, .bytes = log->bytes };
	for (uint32_t digit = 5, rest = log->number; digit != 0u; rest /= 10u)
		entry->name[prefix + --digit] = (char)('0' + rest % 10u);
	return LOG_DONE;
}

static enum log_answer flash_log_read(void *context, unsigned index, uint32_t offset, uint8_t *bytes, size_t *count)
{
	struct flash_log *const log = context;
	const enum log_answer answer = flash_log_find(log, index);

	if (answer != LOG_DONE)
		return answer;
	const uint32_t left = offset < log->bytes ? log->bytes - offset : 0u, payload = flash_log_payload(log);
	const uint32_t in_block = offset % flash_log_block_bytes(log), at = in_block % payload;

	if (left == 0u) {
		*count = 0;
		return LOG_DONE;
	}
	log->wanted = flash_log_walk(log, log->head, offset / flash_log_block_bytes(log)) * log->chip.pages + 1u +
		      in_block / payload;
	const uint32_t ahead = log->wanted - log->held, here = payload - at < left ? payload - at : left;

	if (ahead >= log->held_count)
		return LOG_LATER;
	*count = *count < here ? *count : here;
	memcpy(bytes, log->ring + ahead * log->chip.page_bytes + at, *count);
	return LOG_DONE;
}

static enum log_answer flash_log_erase(void *context)
{
	struct flash_log *const log = context;
	const enum log_answer answer = (enum log_answer)log->answer;

	log->answer = LOG_LATER;
	if (answer != LOG_LATER)
		return answer;
	if (flash_log_is_written(log) || log->chip.blocks == 0u)
		return LOG_FAILED;
	log->asked = log->task == TASK_ERASE;
	if (log->task == TASK_SCAN || log->asked || log->owner != OWNER_NONE)
		return LOG_LATER;
	if (log->counts[FLASH_HEAD] + log->counts[FLASH_BODY] + log->counts[FLASH_VOID] == 0u)
		return LOG_DONE;
	log->asked = true;
	flash_log_erase_all(log, log->foreign);
	return LOG_LATER;
}

void flash_log_init(struct flash_log *log, const struct spi_bus *bus, struct log_device *device)
{
	memset(log, 0, sizeof *log);
	log->answer = LOG_LATER;
	flash_log_rescan(log);
	flash_chip_init(&log->chip, bus, flash_log_fill, log);
	*device = (struct log_device){ .context = log,
				       .step = flash_log_step,
				       .status = flash_log_status,
				       .begin = flash_log_begin,
				       .write = flash_log_write,
				       .end = flash_log_end,
				       .entry = flash_log_entry,
				       .read = flash_log_read,
				       .erase = flash_log_erase };
}
