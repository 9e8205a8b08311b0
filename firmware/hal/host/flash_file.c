#define _GNU_SOURCE
#include "hal/host/flash_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "nf_contract.h"

#define ERASED_BYTE 0xFF
#define MODE 0666 /* as the umask allows */

/* Brings a new file to its size. Returns false, errno set, if the file is neither new nor of that size. */
static bool flash_file_resize(int file, bool *fresh)
{
	struct stat facts;

	if (fstat(file, &facts) != 0)
		return false;
	*fresh = facts.st_size == 0;
	if (*fresh)
		return ftruncate(file, NF_FLASH_BYTES) == 0;
	errno = EFBIG;
	return facts.st_size == NF_FLASH_BYTES;
}

static uint8_t *flash_file_map(int file, bool fresh)
{
	const int flags = file < 0 ? MAP_PRIVATE | MAP_ANONYMOUS : MAP_SHARED;
	uint8_t *bytes = mmap(NULL, NF_FLASH_BYTES, PROT_READ | PROT_WRITE, flags, file, 0);

	if (bytes == MAP_FAILED)
		return NULL;
	if (fresh)
		memset(bytes, ERASED_BYTE, NF_FLASH_BYTES);
	return bytes;
}

uint8_t *flash_file_open(const char *path)
{
	bool fresh = true;

	if (!path)
		return flash_file_map(-1, fresh);
	const int file = open(path, O_RDWR | O_CREAT | O_CLOEXEC, MODE);
	uint8_t *bytes = file >= 0 && flash_file_resize(file, &fresh) ? flash_file_map(file, fresh) : NULL;
	if (!bytes)
		fprintf(stderr, "neuroflight: flash file %s: %s; expected none or one of %u bytes\n", path,
			errno == EFBIG ? "it has another size" : strerror(errno), (unsigned)NF_FLASH_BYTES);
	if (file >= 0)
		close(file);
	return bytes;
}
