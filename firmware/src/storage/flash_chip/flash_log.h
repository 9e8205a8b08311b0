/* Logs on a flash chip, one behind the other in a ring over all its blocks, so that these wear evenly: a log begins in the
 * block behind the last one, and the chip is full when one blank block is left. Nothing is erased but by `erase`, which goes on
 * with the next start where the power has cut it short; so no log waits for it. What another firmware has left on a chip stays
 * until then, too, and no log is written.
 *
 * A block's first page says whose it is (struct flash_record). Each further page holds bytes of the log, then how many as two
 * bytes and the CRC-32 of all that: a page that was being programmed when the power went is known by it.
 *
 * Blocks: BLANK, HEAD (a log's first), BODY (one that continues it), MARK (behind the last log that was erased: the ring goes on
 * there; its second page says that all else is), VOID (none of these, or torn), BAD (NAND: so its maker or we have marked it). */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "port/log_device.h"
#include "storage/flash_chip/flash_chip.h"

#define FLASH_BLOCKS_MAX 2048u
/* Bytes that a pause of 130 ms needs at 125 KB/s; a page takes 0.4 to 5 ms. */
#define FLASH_RING_BYTES 16384u

enum flash_kind { FLASH_BLANK, FLASH_HEAD, FLASH_BODY, FLASH_MARK, FLASH_WHOLE, FLASH_VOID, FLASH_BAD, FLASH_KINDS };

/* The first bytes of a block, and, of kind FLASH_WHOLE, of a mark's second page. */
struct flash_record {
	uint32_t magic;
	uint32_t sequence; /* of the log or mark, from 1 on */
	uint16_t kind; /* enum flash_kind */
	uint16_t index; /* of the block in its log */
	uint32_t crc; /* CRC-32 of what is before */
};

/* What is used most comes first, where short instructions reach it. */
struct flash_log {
	uint8_t state; /* of the log that is written */
	uint8_t error; /* enum nf_log_error */
	uint8_t task; /* what goes on while no log is written */
	uint8_t owner; /* what the chip's job is for */
	uint8_t stage; /* of erasing */
	uint8_t answer; /* enum log_answer about erasing, for who asks next; LOG_LATER: there is nothing to tell */
	uint8_t failures; /* to begin a block, one after the other */
	bool asked; /* somebody waits for the answer */
	bool there; /* a chip was, at the last step */
	bool foreign; /* the chip's content is not ours */
	bool doubtful; /* blank blocks may not be so */
	bool measured; /* `bytes` is known */
	uint32_t sequence; /* the last one */
	uint32_t frontier; /* block from which on the next one is looked for */
	uint32_t block; /* that is looked at, written or erased */
	uint32_t marked; /* block of the mark that is being set, or of the latest record */

	/* Of the log that is written. */
	uint32_t page; /* of `block` that is next; 0: the block is not ours yet */
	uint32_t index; /* of `block` in the log */
	uint32_t taken, written; /* bytes of the log: accepted, on the chip */
	uint32_t left; /* bytes that may still be accepted */
	uint32_t part; /* bytes of the page that is programmed */
	uint32_t crc; /* of its bytes so far */

	/* Of the log that was asked for last. */
	uint32_t head; /* its first block; FLASH_NO_PAGE: none */
	uint32_t number, bytes; /* its sequence, its length */
	uint32_t blocks;
	uint32_t low, high; /* pages between which its last block's content ends */
	uint32_t wanted; /* page that a peer has asked for, or FLASH_NO_PAGE */
	uint32_t held, held_count; /* pages in `ring`: the first one, how many */

	struct flash_chip chip;
	struct flash_record record; /* that is programmed */
	struct flash_record found; /* that was read */
	uint16_t counts[FLASH_KINDS]; /* of blocks */
	uint8_t kinds[FLASH_BLOCKS_MAX]; /* enum flash_kind */
	uint8_t ring[FLASH_RING_BYTES];
};

/* Nothing is moved yet. `device` is filled with what works on `log`. */
void flash_log_init(struct flash_log *log, const struct spi_bus *bus, struct log_device *device);
