/* Logs on an SD card: a flight fills the first empty file of card_files.h from its begin, through a ring that hides the
 * card's pauses. Of the file system nothing is written: whatever happens to card or power, it stays as the computer left
 * it, and the log in the file reaches as far as the last sector that the card took. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "port/log_device.h"
#include "storage/card/card_files.h"
#include "storage/card/sd_card.h"

/* Bytes that two ordinary pauses of a card, 50 ms each, need at 125 KB/s; a multiple of a block. */
#define CARD_RING_BYTES 16384u

/* What is used most comes first, where short instructions reach it. */
struct card_log {
	uint8_t state; /* of the log that is written */
	uint8_t error; /* enum nf_log_error */
	uint8_t owner; /* who the card works for */
	bool there; /* a card was, at the last step */
	bool erasing;
	bool rest_erased; /* of the file all but its first sector */
	bool erase_failed; /* not told yet */
	uint32_t file; /* that is written or erased */
	uint32_t taken; /* bytes of the log, its filling at the end included */
	uint32_t bytes; /* without it */
	uint32_t written; /* sectors that the card has */
	uint32_t opened; /* [ms] when this sequence of writes began */
	uint32_t wanted; /* block that a peer has asked for, or SD_NO_BLOCK */
	struct sd_card card;
	struct card_files files;
	uint8_t ring[CARD_RING_BYTES];
};

/* Nothing is moved yet. `device` is filled with what works on `log`. */
void card_log_init(struct card_log *log, const struct spi_bus *bus, struct log_device *device);
