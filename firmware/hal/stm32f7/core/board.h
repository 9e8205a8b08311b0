/* What is wired to what on the board: data, which toolchain/image/stamp.py writes into the linked image. One code runs on
 * every board with this chip.
 *
 * Pins and DMA streams are told in codes, which pin_of (gpio.h) and stream_of (dma.h) translate. */
#pragma once

#include <stdbool.h>

#include "nf_contract.h"

/* Its section, .board, lies behind the header of the image in a bank. The boot part has one of its own, .boot_board: it
 * knows its board before it has looked at a bank, and refuses images for others. */
extern const struct board board;

/* Is it a description that this code understands? Else nothing of it may be used. */
static inline bool board_is_known(const struct board *described)
{
	return described->magic == NF_BOARD_MAGIC && described->layout == NF_BOARD_LAYOUT &&
	       described->bytes == sizeof(struct board);
}
