/* An SD card (SDHC or SDXC) on an SPI bus: finds it, reads, writes and erases blocks. Nothing waits: a step starts one
 * transfer of the bus, or looks whether the last one has ended.
 *
 * Source: SD Specifications Part 1, Physical Layer Simplified Specification: 4.3 and 7. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "port/spi_bus.h"

#define SD_BLOCK_BYTES 512u
#define SD_NO_BLOCK UINT32_MAX

enum sd_outcome { SD_PENDING, SD_DONE, SD_FAILED };

/* All members are private except those marked as readable. */
struct sd_card {
	const struct spi_bus *bus;
	uint32_t blocks; /* read: of the card; 0: there is none that can be used */
	uint8_t error; /* read: enum nf_log_error, why there is none */
	uint8_t outcome; /* read: of the last job */
	uint32_t held; /* read: the block that `data` holds, SD_NO_BLOCK: none */
	bool writing; /* read: a sequence of writes is open */
	bool reading; /* likewise of reads */

	uint8_t phase, job;
	uint8_t tries; /* of the command */
	uint8_t stumbles; /* of the job */
	bool moving; /* a transfer is under way */
	bool trouble; /* the job needs a fresh start */
	uint32_t since; /* [ms] when the phase began */
	uint32_t next; /* block that goes on with the sequence */
	uint32_t first, last; /* blocks of the job */
	const uint8_t *source;
	uint16_t wanted; /* bytes of data that are read, with their checksum */
	uint16_t taken; /* of these; SD_NO_TOKEN before the first */
	uint8_t data[SD_BLOCK_BYTES + 2u]; /* read, behind a read: its first SD_BLOCK_BYTES */
};

void sd_card_init(struct sd_card *card, const struct spi_bus *bus);
/* As often as possible, once a millisecond or so at least. */
void sd_card_step(struct sd_card *card);

/* Is there a card without a job? Only then these may be called; step until the outcome is not SD_PENDING. Trouble is
 * tried thrice. SD_FAILED without a card behind it: it is gone. */
bool sd_card_free(const struct sd_card *card);
void sd_card_read(struct sd_card *card, uint32_t block);
/* The same where the next block is likely to be read then: a sequence of reads stays open, which makes that quick. */
void sd_card_read_on(struct sd_card *card, uint32_t block);
/* `bytes` must stay until the outcome. SD_DONE: the card has the block and may be asked for the next one. A sequence of
 * writes stays open, which makes the next block quick. */
void sd_card_write(struct sd_card *card, uint32_t block, const uint8_t *bytes);
/* Ends a sequence. SD_DONE: the card says that all is well. */
void sd_card_finish(struct sd_card *card);
void sd_card_erase(struct sd_card *card, uint32_t first, uint32_t last);
