/* A flash chip on an SPI bus, NOR or NAND: finds it, reads, programs and erases. Nothing waits: a step starts transfers of
 * the bus, or looks whether the last one has ended or the chip is at rest.
 *
 * Sources: data sheets of W25Q128JV (rev. F: 8.2, instructions; 9.6, times) and W25N01GV (rev. O: 8.2; 9.5) as far as public
 * drivers that were written from them agree (Linux spi-nor and spinand, flashrom, Betaflight); board-bring-up.md asks for the
 * rest on hardware. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "port/spi_bus.h"

#define FLASH_NO_PAGE UINT32_MAX

enum flash_outcome { FLASH_PENDING, FLASH_DONE, FLASH_FAILED };

/* Writes bytes `column` and following of the page that is being programmed. Asked in their order, each once. */
typedef void (*flash_fill)(void *context, uint32_t column, uint8_t *bytes, size_t count);

/* All members are private except those marked as readable. */
struct flash_chip {
	uint8_t phase, job;
	uint8_t outcome; /* read: of the last job */
	uint8_t error; /* read: enum nf_log_error, why there is no chip */
	uint8_t dies, die; /* chips in the package; the one that listens */
	uint8_t address_bytes;
	bool nand; /* read: blocks may be bad, and say so behind their first page's bytes */
	bool moving; /* a transfer is under way */
	bool quick; /* that takes a few microseconds */
	bool failed; /* the job has */
	uint16_t page_bytes; /* read: of a page, which is programmed as one */
	uint16_t pages; /* read: of a block */
	uint16_t count, moved; /* bytes of the job, and those that have passed */
	uint32_t blocks; /* read: that are erased as one; 0: there is no chip that can be used */
	uint32_t page, column; /* of the job */
	uint8_t *bytes;
	uint32_t cached; /* NAND: page that its buffer holds */
	uint32_t since; /* [ms] when it began to be absent, or busy */
	const struct spi_bus *bus;
	flash_fill fill;
	void *context;
};

void flash_chip_init(struct flash_chip *chip, const struct spi_bus *bus, flash_fill fill, void *context);
/* As often as possible, once a millisecond or so at least. */
void flash_chip_step(struct flash_chip *chip);

/* Is there a chip without a job? Only then these may be called; step until the outcome is not FLASH_PENDING. */
bool flash_chip_free(const struct flash_chip *chip);
/* Pages count from the chip's begin. `count`: at least 1, to the page's end at most, or of NAND some of its spare bytes.
 * FLASH_FAILED: more bits have changed than the chip can mend; `bytes` are as they are. */
void flash_chip_read(struct flash_chip *chip, uint32_t page, uint32_t column, uint8_t *bytes, size_t count);
/* Bits that are 1 in what `fill` gives, and the page's other bytes, stay as they are. FLASH_FAILED: the chip says so, or would
 * not let itself be written. */
void flash_chip_program(struct flash_chip *chip, uint32_t page, uint32_t column, size_t count);
void flash_chip_erase(struct flash_chip *chip, uint32_t block);
