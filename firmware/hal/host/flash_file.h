/* The bytes of a flash model: a file that outlives the program, or memory that does not. */
#ifndef HOST_FLASH_FILE_H
#define HOST_FLASH_FILE_H

#include <stdint.h>

/* NF_FLASH_BYTES of flash in the file `path`, which is made, erased, if there is none; what is written to them is in
 * the file at once. `path` NULL: erased memory. Returns NULL after one line on stderr if that fails. */
uint8_t *flash_file_open(const char *path);

#endif
