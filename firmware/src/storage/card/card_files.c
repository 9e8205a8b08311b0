#include "storage/card/card_files.h"

#include <string.h>

#include "nf_contract.h"

enum phase {
	FILES_PARTITION, /* block 0 */
	FILES_VOLUME,    /* the first block of the file system */
	FILES_ROOT,      /* a sector of the root directory */
	FILES_ROOT_NEXT, /* the FAT's word about a cluster of it */
	FILES_FIRST,     /* a file's first sector */
	FILES_CHAIN,     /* the FAT's words about a file's clusters */
	FILES_END,       /* the sector in the middle, then the last one of a log */
	FILES_KNOWN,
	FILES_FAILED,
};

/* Offsets in the first block of a disk or of a volume (3.1, 3.2 and the partition table's). */
enum {
	SIGNATURE = 510,
	PARTITIONS = 446,
	PARTITION_BYTES = 16,
	PARTITION_COUNT = 4,
	PARTITION_TYPE = 4,
	PARTITION_FIRST = 8,
	BYTES_PER_SECTOR = 11,
	SECTORS_PER_CLUSTER = 13,
	RESERVED_SECTORS = 14,
	FATS = 16,
	ROOT_ENTRIES = 17,
	SECTORS_16 = 19,
	FAT_SECTORS_16 = 22,
	SECTORS_32 = 32,
	FAT_SECTORS = 36,
	FLAGS = 40,
	VERSION = 42,
	ROOT_CLUSTER = 44,
};
enum { NOT_MIRRORED = 0x80 }; /* of the flags: the first FAT may be an old one */
enum { TYPE_FAT32 = 0x0B, TYPE_FAT32_LBA = 0x0C };
/* A directory entry (6). */
enum { ENTRY_BYTES = 32, NAME_BYTES = 11, ATTRIBUTES = 11, CLUSTER_HIGH = 20, CLUSTER_LOW = 26, SIZE = 28 };
enum { NOT_A_FILE = 0x18 }; /* of the attributes: a label, a directory, or a part of a long name */
enum { DELETED = 0xE5 };
#define FAT_WORDS (SD_BLOCK_BYTES / 4u)
#define FAT_MASK 0x0FFFFFFFu
#define FAT_LAST 0x0FFFFFF8u /* and above: a chain ends */
#define CLUSTERS_MAX 0x0FFFFFF5u

static uint32_t files_u16(const uint8_t *bytes)
{
	return bytes[0] | (uint32_t)bytes[1] << 8;
}

static uint32_t files_u32(const uint8_t *bytes)
{
	return files_u16(bytes) | files_u16(bytes + 2) << 16;
}

static bool files_blank(const uint8_t *sector)
{
	if (sector[0] != 0x00u && sector[0] != 0xFFu)
		return false;
	return memcmp(sector, sector + 1, SD_BLOCK_BYTES - 1u) == 0;
}

static bool files_is_cluster(const struct card_files *files, uint32_t cluster)
{
	return cluster >= 2u && cluster - 2u < files->clusters;
}

/* Only of a cluster that there is: the volume's size was checked against the card's. */
static uint32_t files_block_of(const struct card_files *files, uint32_t cluster)
{
	return files->clusters_at + (cluster - 2u) * files->cluster_sectors;
}

static void files_fail(struct card_files *files, enum nf_log_error error)
{
	files->error = (uint8_t)error;
	files->phase = FILES_FAILED;
	files->count = 0;
}

/* ---- the volume ---- */

static bool files_is_volume(const uint8_t *block)
{
	return files_u16(block + SIGNATURE) == 0xAA55u && files_u16(block + BYTES_PER_SECTOR) == SD_BLOCK_BYTES &&
	       files_u16(block + ROOT_ENTRIES) == 0u && files_u16(block + FAT_SECTORS_16) == 0u &&
	       files_u32(block + FAT_SECTORS) != 0u;
}

/* Takes the sizes of a volume at block files->partition of a card of `blocks`. */
static bool files_take_volume(struct card_files *files, const uint8_t *block, uint32_t blocks)
{
	const uint32_t cluster_sectors = block[SECTORS_PER_CLUSTER], fats = block[FATS];
	const uint32_t reserved = files_u16(block + RESERVED_SECTORS), fat_sectors = files_u32(block + FAT_SECTORS);
	const uint32_t sectors = files_u32(block + SECTORS_32), root = files_u32(block + ROOT_CLUSTER) & FAT_MASK;
	const uint64_t before = reserved + (uint64_t)fats * fat_sectors; /* the first cluster */

	if (!files_is_volume(block) || files_u16(block + SECTORS_16) != 0u || files_u16(block + VERSION) != 0u ||
	    (block[FLAGS] & NOT_MIRRORED) != 0u || cluster_sectors == 0u ||
	    (cluster_sectors & (cluster_sectors - 1u)) != 0u || reserved == 0u || fats == 0u || before >= sectors ||
	    sectors > blocks - files->partition)
		return false;
	files->cluster_sectors = cluster_sectors;
	files->clusters = (sectors - (uint32_t)before) / cluster_sectors;
	files->fat = files->partition + reserved;
	files->clusters_at = files->partition + (uint32_t)before;
	files->cluster = root;
	return files->clusters <= CLUSTERS_MAX && (files->clusters + 1u) / FAT_WORDS < fat_sectors &&
	       files_is_cluster(files, root);
}

static void files_partition(struct card_files *files, const uint8_t *block, uint32_t blocks)
{
	files->partition = 0;
	if (files_is_volume(block)) {
		files->phase = FILES_VOLUME; /* without a partition table: the same block once more */
		return;
	}
	for (unsigned i = 0; i < PARTITION_COUNT && files_u16(block + SIGNATURE) == 0xAA55u; ++i) {
		const uint8_t *const entry = block + PARTITIONS + i * PARTITION_BYTES;
		const uint32_t first = files_u32(entry + PARTITION_FIRST);
		const uint8_t type = entry[PARTITION_TYPE];

		if ((type != TYPE_FAT32 && type != TYPE_FAT32_LBA) || first == 0u || first >= blocks)
			continue;
		files->partition = first;
		files->phase = FILES_VOLUME;
		return;
	}
	files_fail(files, NF_LOG_ERROR_FILE_SYSTEM);
}

static void files_root(struct card_files *files)
{
	files->root[files->roots++] = files->cluster;
	files->sector = 0;
	files->phase = FILES_ROOT;
}

static void files_volume(struct card_files *files, const uint8_t *block, uint32_t blocks)
{
	if (files_take_volume(files, block, blocks))
		files_root(files);
	else
		files_fail(files, NF_LOG_ERROR_FILE_SYSTEM);
}

/* ---- the root directory ---- */

static bool files_is_log(const uint8_t *entry)
{
	if ((entry[ATTRIBUTES] & NOT_A_FILE) != 0u || memcmp(entry + CARD_NAME_BYTES, "BBL", 3) != 0)
		return false;
	for (unsigned i = 0; i < CARD_NAME_BYTES; ++i)
		if (entry[i] < ' ' || entry[i] > '~')
			return false;
	return entry[0] != ' ' && files_u32(entry + SIZE) >= SD_BLOCK_BYTES;
}

/* In the order of names; a name that is there already makes no difference. */
static void files_add(struct card_files *files, const uint8_t *entry)
{
	uint32_t place = files->count;

	while (place != 0u && memcmp(files->files[place - 1u].name, entry, CARD_NAME_BYTES) > 0)
		--place;
	if (place == CARD_FILES_MAX)
		return;
	if (files->count < CARD_FILES_MAX)
		++files->count;
	struct card_file *const file = &files->files[place];
	memmove(file + 1, file, (files->count - 1u - place) * sizeof *file);
	memset(file, 0, sizeof *file);
	memcpy(file->name, entry, CARD_NAME_BYTES);
	file->cluster = (files_u16(entry + CLUSTER_HIGH) << 16 | files_u16(entry + CLUSTER_LOW)) & FAT_MASK;
	file->sectors = files_u32(entry + SIZE) / SD_BLOCK_BYTES;
	file->bytes = CARD_BYTES_UNKNOWN;
}

/* ---- which file is next ---- */

/* Returns the index of the first file in `state`, complete or not; `count` if there is none. */
static uint32_t files_find(const struct card_files *files, enum card_file_state state, bool whole)
{
	uint32_t i = 0;

	while (i < files->count && (files->files[i].state != state || files->files[i].whole != whole))
		++i;
	return i;
}

static bool files_seek(struct card_files *files, enum card_file_state state)
{
	files->file = files_find(files, state, false);
	return files->file < files->count;
}

/* A walk along the FAT begins at the file's first cluster. */
static void files_walk(struct card_files *files)
{
	const struct card_file *const file = &files->files[files->file];

	files->cluster = file->cluster;
	files->left = (file->sectors + files->cluster_sectors - 1u) / files->cluster_sectors;
	files->phase = FILES_CHAIN;
}

/* All first sectors, then the chains: of the files that can take a log, then of the others. */
static void files_next(struct card_files *files)
{
	if (files_seek(files, CARD_FILE_FOUND))
		files->phase = FILES_FIRST;
	else if (files_seek(files, CARD_FILE_BLANK) || files_seek(files, CARD_FILE_WRITTEN))
		files_walk(files);
	else
		files->phase = FILES_KNOWN;
}

static void files_refuse(struct card_files *files, enum nf_log_error error)
{
	files->files[files->file].state = CARD_FILE_REFUSED;
	files->files[files->file].whole = false;
	files->error = (uint8_t)error;
	files_next(files);
}

/* Do clusters `first` to `last` touch the directory, or a file that has been accepted? */
static bool files_overlap(const struct card_files *files, uint32_t first, uint32_t last)
{
	for (uint32_t i = 0; i < files->roots; ++i)
		if (files->root[i] >= first && files->root[i] <= last)
			return true;
	for (uint32_t i = 0; i < files->count; ++i) {
		const struct card_file *const file = &files->files[i];
		const uint32_t end = file->cluster + (file->sectors - 1u) / files->cluster_sectors;

		if (file->whole && file->cluster <= last && end >= first)
			return true;
	}
	return false;
}

/* Looks whether the directory's numbers can be, and where the file lies. Sound as far as that goes: its first sector is
 * next. */
static void files_locate(struct card_files *files)
{
	for (uint32_t i = 0; i < files->count; ++i) {
		struct card_file *const file = &files->files[i];
		const uint32_t clusters = (file->sectors - 1u) / files->cluster_sectors; /* behind the first */

		if (files_is_cluster(files, file->cluster) && clusters < files->clusters - (file->cluster - 2u))
			file->block = files_block_of(files, file->cluster);
		else
			file->state = CARD_FILE_REFUSED;
		if (file->state == CARD_FILE_REFUSED)
			files->error = NF_LOG_ERROR_FILE_SYSTEM;
	}
	if (files->count == 0u)
		files_fail(files, NF_LOG_ERROR_NO_FILE);
	else
		files_next(files);
}

static void files_directory(struct card_files *files, const uint8_t *block)
{
	for (unsigned at = 0; at < SD_BLOCK_BYTES; at += ENTRY_BYTES) {
		if (block[at] == 0u) { /* no more entries */
			files_locate(files);
			return;
		}
		if (block[at] != DELETED && files_is_log(block + at))
			files_add(files, block + at);
	}
	if (++files->sector == files->cluster_sectors)
		files->phase = FILES_ROOT_NEXT;
}

/* The FAT's word about `cluster`, in the sector that was read for it. */
static uint32_t files_word(const uint8_t *block, uint32_t cluster)
{
	return files_u32(block + cluster % FAT_WORDS * 4u) & FAT_MASK;
}

static void files_directory_next(struct card_files *files, const uint8_t *block)
{
	files->cluster = files_word(block, files->cluster);
	if (files->cluster >= FAT_LAST)
		files_locate(files);
	else if (!files_is_cluster(files, files->cluster) || files->roots == CARD_ROOT_CLUSTERS_MAX)
		files_fail(files, NF_LOG_ERROR_FILE_SYSTEM); /* longer than any that we make, or a circle */
	else
		files_root(files);
}

/* ---- a file ---- */

static void files_first(struct card_files *files, const uint8_t *block)
{
	files->files[files->file].state = files_blank(block) ? CARD_FILE_BLANK : CARD_FILE_WRITTEN;
	files_next(files);
}

/* One sector of the FAT: each cluster must be followed by its neighbour, and the last one be in use. */
static void files_chain(struct card_files *files, const uint8_t *block)
{
	struct card_file *const file = &files->files[files->file];

	do {
		const uint32_t word = files_word(block, files->cluster);

		if (--files->left == 0u) {
			if (word < 2u || files_overlap(files, file->cluster, files->cluster)) {
				files_refuse(files, NF_LOG_ERROR_FILE_SYSTEM);
				return;
			}
			file->whole = true;
			files_next(files);
			return;
		}
		if (word != files->cluster + 1u) {
			files_refuse(files, NF_LOG_ERROR_FRAGMENTED);
			return;
		}
		++files->cluster;
	} while (files->cluster % FAT_WORDS != 0u);
}

void card_files_measure(struct card_files *files, uint32_t file)
{
	files->file = file;
	files->low = 0;
	files->high = files->files[file].sectors;
	files->phase = FILES_END;
}

/* A log fills its file from the begin. Its last byte is a 0, the end of LOG_END, and further ones fill its last sector up:
 * it ends a byte behind the last one that is not blank. One that was cut off may be told a byte too long. */
static void files_end(struct card_files *files, const uint8_t *block)
{
	if (files->high - files->low > 1u) {
		const uint32_t middle = files->low + (files->high - files->low) / 2u;

		if (files_blank(block))
			files->high = middle;
		else
			files->low = middle;
		return;
	}
	uint32_t count = SD_BLOCK_BYTES;
	const uint8_t filler = block[SD_BLOCK_BYTES - 1u];

	while (count != 0u && block[count - 1u] == filler && (filler == 0x00u || filler == 0xFFu))
		--count;
	struct card_file *const file = &files->files[files->file];
	file->bytes = files->low * SD_BLOCK_BYTES + count;
	file->bytes += file->bytes != file->sectors * SD_BLOCK_BYTES;
	files->phase = FILES_KNOWN;
}

/* ---- all of it ---- */

void card_files_init(struct card_files *files)
{
	memset(files, 0, sizeof *files);
}

bool card_files_idle(const struct card_files *files)
{
	return !files->asked;
}

bool card_files_known(const struct card_files *files)
{
	return files->phase >= FILES_KNOWN;
}

uint32_t card_files_empty(const struct card_files *files)
{
	return files_find(files, CARD_FILE_BLANK, true);
}

/* The block that the phase needs. */
static uint32_t files_needed(const struct card_files *files)
{
	switch (files->phase) {
	case FILES_PARTITION:
		return 0;
	case FILES_VOLUME:
		return files->partition;
	case FILES_ROOT:
		return files_block_of(files, files->cluster) + files->sector;
	case FILES_FIRST:
		return files->files[files->file].block;
	case FILES_END:
		return files->files[files->file].block + files->low + (files->high - files->low) / 2u;
	default:
		return files->fat + files->cluster / FAT_WORDS;
	}
}

static void files_take(struct card_files *files, const uint8_t *block, uint32_t blocks)
{
	switch (files->phase) {
	case FILES_PARTITION:
		files_partition(files, block, blocks);
		break;
	case FILES_VOLUME:
		files_volume(files, block, blocks);
		break;
	case FILES_ROOT:
		files_directory(files, block);
		break;
	case FILES_ROOT_NEXT:
		files_directory_next(files, block);
		break;
	case FILES_FIRST:
		files_first(files, block);
		break;
	case FILES_CHAIN:
		files_chain(files, block);
		break;
	default:
		files_end(files, block);
		break;
	}
}

void card_files_step(struct card_files *files, struct sd_card *card)
{
	if (files->asked) {
		if (card->outcome == SD_PENDING)
			return;
		files->asked = false;
		if (card->outcome == SD_FAILED && files->phase >= FILES_FIRST)
			files_refuse(files, NF_LOG_ERROR_READ);
		else if (card->outcome == SD_FAILED)
			files_fail(files, NF_LOG_ERROR_READ);
		else
			files_take(files, card->data, card->blocks);
		return;
	}
	if (card_files_known(files) || !sd_card_free(card))
		return;
	files->asked = true;
	sd_card_read(card, files_needed(files));
}

uint32_t card_files_place(const struct card_files *files, uint32_t file, uint32_t sector, uint32_t count)
{
	if (file >= files->count)
		return SD_NO_BLOCK;
	const struct card_file *const there = &files->files[file];

	if (!there->whole || sector >= there->sectors || count > there->sectors - sector)
		return SD_NO_BLOCK;
	return there->block + sector;
}
