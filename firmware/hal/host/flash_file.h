/* The bytes of a flash model: a file that outlives the program, or memory that does not. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "port/flash.h"

struct flash_file {
	const char *path;
	int file;           /* locked while the program runs; -1: memory alone */
	bool behind;        /* the file lacks bytes of the memory: the next change writes all of them */
	bool complained;    /* of a change that did not reach the file */
	uint8_t *bytes;     /* NF_FLASH_BYTES */
	struct flash model; /* over `bytes` */
};

/* NF_FLASH_BYTES of flash at `bytes`, read from the file `path`, which is made if there is none. The file is this program's
 * alone until it ends. `path` NULL: memory. New flash is erased, but for what `install` puts there; a file keeps what it has.
 * Returns false after one line on stderr. */
bool flash_file_open(struct flash_file *flash, const char *path, void (*install)(uint8_t *bytes));

/* `model`, a flash model over `bytes`, for the core: what it changes is in the file at once. Where the file does not
 * take it, erasing and programming fail. `flash` must outlive what it is handed to. */
struct flash flash_file_interface(struct flash_file *flash, const struct flash *model);
