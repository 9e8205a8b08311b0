#include "storage/card/card_log.h"

#include <string.h>

/* Duration of a sequence of writes [ms]. At its end the card has written all data, also what it may have buffered,
 * and its status is checked. */
#define SEQUENCE_MS 500u

enum log_state {
	LOG_NONE,
	LOG_OPEN,
	LOG_ENDING,  /* the rest is being written */
	LOG_CLOSING, /* the card finishes it */
	LOG_ENDED,   /* well, but nobody has asked yet */
	LOG_BROKEN,  /* the card took no more: all further bytes are refused */
};
enum owner { OWNER_NONE, OWNER_WRITER, OWNER_FINISHER, OWNER_ERASER, OWNER_READER };

_Static_assert(CARD_RING_BYTES % SD_BLOCK_BYTES == 0u && (CARD_RING_BYTES & (CARD_RING_BYTES - 1u)) == 0u,
	       "sectors lie in one piece, and counts of bytes wrap with the ring");

static bool log_is_written(const struct card_log *log)
{
	return log->state == LOG_OPEN || log->state == LOG_ENDING || log->state == LOG_CLOSING;
}

/* Everything that changes the card: `count` sectors of a file become blank, or one becomes `bytes`. Returns whether it has
 * begun: never outside a file that was found sound. */
static bool log_change(struct card_log *log, uint32_t sector, uint32_t count, const uint8_t *bytes)
{
	const uint32_t block = card_files_place(&log->files, log->file, sector, count);

	if (block == SD_NO_BLOCK || count == 0u)
		return false;
	if (bytes == NULL)
		sd_card_erase(&log->card, block, block + count - 1u);
	else
		sd_card_write(&log->card, block, bytes);
	return true;
}

/* ---- writing ---- */

static void log_break(struct card_log *log, enum nf_log_error error)
{
	if (log_is_written(log)) {
		log->state = LOG_BROKEN;
		if (log->written == 0u) /* the next log takes another one */
			log->files.files[log->file].state = CARD_FILE_REFUSED;
	}
	log->error = (uint8_t)error;
}

/* Records the new content of the file. */
static void log_note(struct card_log *log)
{
	struct card_file *const file = &log->files.files[log->file];
	const uint32_t there = log->written * SD_BLOCK_BYTES;

	if (log->written == 0u)
		return;
	file->state = CARD_FILE_WRITTEN;
	file->bytes = log->bytes < there ? log->bytes : there;
}

static void log_write_on(struct card_log *log, uint32_t now)
{
	const bool waits = log->taken - log->written * SD_BLOCK_BYTES >= SD_BLOCK_BYTES;
	const uint32_t at = log->written * SD_BLOCK_BYTES % CARD_RING_BYTES;

	if (!log->card.writing)
		log->opened = now;
	if (now - log->opened >= SEQUENCE_MS || (!waits && log->state == LOG_ENDING)) {
		if (!waits && log->state == LOG_ENDING)
			log->state = LOG_CLOSING;
		log->owner = OWNER_FINISHER;
		sd_card_finish(&log->card);
	} else if (waits) {
		if (log_change(log, log->written, 1, log->ring + at))
			log->owner = OWNER_WRITER;
		else
			log_break(log, NF_LOG_ERROR_WRITE);
	}
}

/* ---- erasing ---- */

/* The first file from log->file on that has a log; false: none is left. */
static bool log_next_used(struct card_log *log)
{
	while (log->file < log->files.count &&
	       !(log->files.files[log->file].whole && log->files.files[log->file].state == CARD_FILE_WRITTEN))
		++log->file;
	return log->file < log->files.count;
}

/* The first sector goes last: where it is blank, all of the file is. */
static void log_erase_on(struct card_log *log)
{
	if (!log_next_used(log)) {
		log->erasing = false;
		card_files_init(&log->files); /* what the card made of it is looked at */
		return;
	}
	const uint32_t rest = log->files.files[log->file].sectors - 1u;
	const bool first = log->rest_erased || rest == 0u;

	if (!(first ? log_change(log, 0, 1, NULL) : log_change(log, 1, rest, NULL)))
		return;
	log->owner = OWNER_ERASER;
	log->rest_erased = !first;
	log->file += first;
}

/* ---- what the card has done ---- */

static void log_done(struct card_log *log, bool well)
{
	const enum owner owner = log->owner;

	log->owner = OWNER_NONE;
	if (owner == OWNER_WRITER && well) {
		++log->written;
		log_note(log);
	} else if (owner == OWNER_FINISHER && well && log->state == LOG_CLOSING) {
		log->state = LOG_ENDED;
	} else if (owner == OWNER_WRITER || owner == OWNER_FINISHER) {
		if (!well)
			log_break(log, NF_LOG_ERROR_WRITE);
	} else if (!well) {
		log->error = owner == OWNER_READER ? NF_LOG_ERROR_READ : NF_LOG_ERROR_WRITE;
		log->erase_failed |= owner == OWNER_ERASER;
		log->erasing = false;
		log->wanted = SD_NO_BLOCK;
	}
}

/* There is no card that could be used. */
static void log_forget(struct card_log *log)
{
	log->there = false;
	log->erase_failed |= log->erasing;
	log->erasing = false;
	log->owner = OWNER_NONE;
	log->wanted = SD_NO_BLOCK;
	log_break(log, (enum nf_log_error)log->card.error);
	card_files_init(&log->files);
}

static void log_step(void *context)
{
	struct card_log *const log = context;
	struct sd_card *const card = &log->card;

	sd_card_step(card);
	if (card->blocks == 0u) {
		if (log->there)
			log_forget(log);
		return;
	}
	log->there = true;
	if (log->owner != OWNER_NONE && card->outcome != SD_PENDING)
		log_done(log, card->outcome == SD_DONE);
	if (!card_files_idle(&log->files) || (!log_is_written(log) && !log->erasing && log->wanted == SD_NO_BLOCK)) {
		card_files_step(&log->files, card);
		return;
	}
	if (log->owner != OWNER_NONE || !sd_card_free(card))
		return;
	if (log_is_written(log)) {
		log_write_on(log, card->bus->milliseconds(card->bus->context));
	} else if (log->erasing) {
		log_erase_on(log);
	} else if (card->held != log->wanted) {
		log->owner = OWNER_READER;
		sd_card_read_on(card, log->wanted);
	}
}

/* ---- as a device ---- */

static uint8_t log_state(const struct card_log *log)
{
	const struct card_files *const files = &log->files;

	if (log->card.blocks == 0u) {
		if (log->card.error == NF_LOG_ERROR_NONE)
			return NF_LOG_STATE_STARTING;
		return log->card.error == NF_LOG_ERROR_NO_CARD ? NF_LOG_STATE_ABSENT : NF_LOG_STATE_FAULT;
	}
	if (log->state == LOG_OPEN)
		return log->taken / SD_BLOCK_BYTES == files->files[log->file].sectors ? NF_LOG_STATE_FULL :
											NF_LOG_STATE_LOGGING;
	if (log->state == LOG_BROKEN)
		return NF_LOG_STATE_FAULT;
	if (log_is_written(log))
		return NF_LOG_STATE_ENDING;
	if (log->erasing)
		return NF_LOG_STATE_STARTING;
	if (card_files_empty(files) != files->count)
		return NF_LOG_STATE_READY;
	if (!card_files_known(files))
		return NF_LOG_STATE_STARTING;
	return files->error == NF_LOG_ERROR_NONE ? NF_LOG_STATE_FULL : NF_LOG_STATE_FAULT;
}

static void log_status(void *context, struct log_device_status *status)
{
	const struct card_log *const log = context;

	*status = (struct log_device_status){
		.state = log_state(log),
		.error = log->error,
		.looking = log->card.blocks != 0u && !card_files_known(&log->files),
	};
	if (status->error == NF_LOG_ERROR_NONE)
		status->error = log->card.error != NF_LOG_ERROR_NONE ? log->card.error : log->files.error;
	for (uint32_t i = 0; i < log->files.count; ++i) {
		const struct card_file *const file = &log->files.files[i];

		if (!file->whole)
			continue;
		status->capacity_kb += file->sectors / 2u;
		if (file->state == CARD_FILE_BLANK) {
			++status->empty;
			status->free_kb += file->sectors / 2u;
		} else if (file->state == CARD_FILE_WRITTEN) {
			++status->logs;
		}
	}
}

static enum log_answer log_begin(void *context)
{
	struct card_log *const log = context;
	const uint8_t state = log_state(log);

	if (state != NF_LOG_STATE_READY)
		return state == NF_LOG_STATE_STARTING ? LOG_LATER : LOG_FAILED;
	log->file = card_files_empty(&log->files);
	log->taken = 0;
	log->bytes = 0;
	log->written = 0;
	log->wanted = SD_NO_BLOCK;
	log->error = NF_LOG_ERROR_NONE;
	log->state = LOG_OPEN;
	return LOG_DONE;
}

static size_t log_write(void *context, const uint8_t *bytes, size_t count)
{
	struct card_log *const log = context;

	if (log->state != LOG_OPEN)
		return 0;
	const uint32_t room = CARD_RING_BYTES - (log->taken - log->written * SD_BLOCK_BYTES);
	const uint32_t left = log->files.files[log->file].sectors * SD_BLOCK_BYTES - log->taken;
	const uint32_t limit = room < left ? room : left, all = count < limit ? (uint32_t)count : limit;
	const uint32_t at = log->taken % CARD_RING_BYTES, before_end = CARD_RING_BYTES - at;
	const uint32_t first = all < before_end ? all : before_end;

	memcpy(log->ring + at, bytes, first);
	memcpy(log->ring, bytes + first, all - first);
	log->taken += all;
	log->bytes = log->taken;
	return all;
}

static enum log_answer log_end(void *context)
{
	struct card_log *const log = context;
	const uint8_t state = log->state;

	if (state == LOG_OPEN) {
		const uint32_t rest = (0u - log->taken) % SD_BLOCK_BYTES;

		memset(log->ring + log->taken % CARD_RING_BYTES, 0, rest);
		log->taken += rest;
		log->state = LOG_ENDING;
	} else if (state != LOG_ENDING && state != LOG_CLOSING) {
		log->state = LOG_NONE;
		return state == LOG_ENDED ? LOG_DONE : LOG_FAILED;
	}
	return LOG_LATER;
}

/* Returns the file of log `index`; NULL and the error if it is not known now. */
static const struct card_file *log_find(struct card_log *log, unsigned index, enum log_answer *answer)
{
	*answer = LOG_FAILED;
	if (log_is_written(log) || log->card.blocks == 0u)
		return NULL;
	*answer = LOG_LATER;
	if (log->erasing || !card_files_known(&log->files))
		return NULL;
	for (uint32_t i = 0; i < log->files.count; ++i) {
		const struct card_file *const file = &log->files.files[i];

		if (!file->whole || file->state != CARD_FILE_WRITTEN || index-- != 0u)
			continue;
		if (file->bytes != CARD_BYTES_UNKNOWN)
			return file;
		log->wanted = SD_NO_BLOCK;
		card_files_measure(&log->files, i);
		return NULL;
	}
	*answer = LOG_FAILED;
	return NULL;
}

static enum log_answer log_entry(void *context, unsigned index, struct log_entry *entry)
{
	enum log_answer answer;
	const struct card_file *const file = log_find(context, index, &answer);
	unsigned length = 0;

	if (file == NULL)
		return answer;
	*entry = (struct log_entry){ .bytes = file->bytes };
	while (length < CARD_NAME_BYTES && file->name[length] != ' ') {
		entry->name[length] = file->name[length];
		++length;
	}
	memcpy(entry->name + length, NF_LOG_FILE_SUFFIX, sizeof NF_LOG_FILE_SUFFIX);
	return LOG_DONE;
}

static enum log_answer log_read(void *context, unsigned index, uint32_t offset, uint8_t *bytes, size_t *count)
{
	struct card_log *const log = context;
	enum log_answer answer;
	const struct card_file *const file = log_find(log, index, &answer);

	if (file == NULL)
		return answer;
	const uint32_t left = offset < file->bytes ? file->bytes - offset : 0u, at = offset % SD_BLOCK_BYTES;

	if (left == 0u) {
		*count = 0;
		return LOG_DONE;
	}
	const uint32_t here = SD_BLOCK_BYTES - at < left ? SD_BLOCK_BYTES - at : left;
	const uint32_t block = file->block + offset / SD_BLOCK_BYTES;

	if (log->card.held != block || !sd_card_free(&log->card)) {
		const bool failed = log->error == NF_LOG_ERROR_READ;

		log->wanted = failed ? SD_NO_BLOCK : block;
		if (failed)
			log->error = NF_LOG_ERROR_NONE; /* told once; the next call tries again */
		return failed ? LOG_FAILED : LOG_LATER;
	}
	log->wanted = SD_NO_BLOCK;
	*count = *count < here ? *count : here;
	memcpy(bytes, log->card.data + at, *count);
	return LOG_DONE;
}

static enum log_answer log_erase(void *context)
{
	struct card_log *const log = context;

	if (log->erase_failed) {
		log->erase_failed = false;
		return LOG_FAILED;
	}
	if (log_is_written(log) || log->card.blocks == 0u)
		return LOG_FAILED;
	if (log->erasing || !card_files_known(&log->files))
		return LOG_LATER;
	log->file = 0;
	if (!log_next_used(log))
		return LOG_DONE;
	log->file = 0;
	log->rest_erased = false;
	log->wanted = SD_NO_BLOCK;
	log->erasing = true;
	return LOG_LATER;
}

void card_log_init(struct card_log *log, const struct spi_bus *bus, struct log_device *device)
{
	memset(log, 0, sizeof *log);
	log->wanted = SD_NO_BLOCK;
	sd_card_init(&log->card, bus);
	card_files_init(&log->files);
	*device = (struct log_device){ .context = log,
				       .step = log_step,
				       .status = log_status,
				       .begin = log_begin,
				       .write = log_write,
				       .end = log_end,
				       .entry = log_entry,
				       .read = log_read,
				       .erase = log_erase };
}
