/* The files for logs on a card that a computer formatted FAT32: *.BBL in its root directory, each in one piece. Only
 * reads: what a file system says of itself is never changed, and nothing of what it says is believed unchecked.
 *
 * Source: Microsoft, FAT: General Overview of On-Disk Format, version 1.03. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "storage/card/sd_card.h"

#define CARD_FILES_MAX 64u /* more are not looked at: those that come first by name stay */
#define CARD_ROOT_CLUSTERS_MAX 64u
#define CARD_NAME_BYTES 8u
#define CARD_BYTES_UNKNOWN UINT32_MAX

enum card_file_state {
	CARD_FILE_FOUND,   /* in the directory */
	CARD_FILE_BLANK,   /* its first sector is */
	CARD_FILE_WRITTEN, /* it is not */
	CARD_FILE_REFUSED, /* in pieces, or not sound */
};

struct card_file {
	char name[CARD_NAME_BYTES]; /* filled up with spaces, without the BBL */
	uint8_t state; /* enum card_file_state */
	bool whole; /* it lies in one piece that is its own: only such a file may be written or read */
	uint32_t cluster; /* its first one */
	uint32_t block; /* of the card: its first one */
	uint32_t sectors; /* whole ones */
	uint32_t bytes; /* of the log in it, or CARD_BYTES_UNKNOWN */
};

struct card_files {
	uint8_t phase;
	uint8_t error; /* enum nf_log_error */
	bool asked; /* a block is being read */
	uint32_t count; /* of files */
	uint32_t file; /* that is looked at */

	uint32_t partition; /* block */
	uint32_t fat, clusters_at; /* blocks of the card: the first FAT, the first cluster */
	uint32_t clusters; /* those that there are: 2..clusters + 1 */
	uint32_t cluster_sectors;
	uint32_t cluster, sector, left; /* where a walk is: cluster, sector of it; clusters to go */
	uint32_t low, high; /* sectors between which a log ends */

	uint32_t roots; /* clusters of the root directory */
	uint32_t root[CARD_ROOT_CLUSTERS_MAX];
	struct card_file files[CARD_FILES_MAX]; /* by name */
};

/* Everything anew, for another card. */
void card_files_init(struct card_files *files);
/* Goes on, while `card` is free or works for this: one block a call at most. */
void card_files_step(struct card_files *files, struct sd_card *card);
/* Is there nothing under way on the card? */
bool card_files_idle(const struct card_files *files);
/* Has all been looked at? */
bool card_files_known(const struct card_files *files);
/* Finds out how long the log in `file` is: until then it is not idle. Only where all has been looked at. */
void card_files_measure(struct card_files *files, uint32_t file);
/* Returns the index of the first file that can take a log; `count` if there is none. */
uint32_t card_files_empty(const struct card_files *files);

/* Where sectors `sector` to `sector` + `count` - 1 of `file` lie; SD_NO_BLOCK: they are not all in a sound file. */
uint32_t card_files_place(const struct card_files *files, uint32_t file, uint32_t sector, uint32_t count);
