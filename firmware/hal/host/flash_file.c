#define _GNU_SOURCE
#include "hal/host/flash_file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "nf_contract.h"

#define ERASED_BYTE 0xFF
#define MODE 0666u /* as the umask allows */
#define NEW_NAME ".flash-XXXXXX"

/* Errors of our own: none of the system's says what to do. */
enum { FLASH_FILE_KIND = -1, FLASH_FILE_SIZE = -2, FLASH_FILE_ZEROS = -3, FLASH_FILE_USED = -4 };
_Static_assert(NF_FLASH_BYTES == 524288, "as the words below say");

static bool flash_file_refused(const struct flash_file *flash, int error)
{
	static const struct {
		const char *what, *expected;
	} own[] = {
		[-FLASH_FILE_KIND] = { "it is no file", "name a file in a place that can be written" },
		[-FLASH_FILE_SIZE] = { "it has another size", "expected none or one of 524288 bytes, name another" },
		[-FLASH_FILE_ZEROS] = { "a sector of it is all zeros, which flash never is: it was not written whole",
					"remove it or name another" },
		[-FLASH_FILE_USED] = { "another program uses it", "end that one or name another" },
	};

	fprintf(stderr, "neuroflight: flash file %s: %s; %s\n", flash->path,
		error < 0 ? own[-error].what : strerror(error), own[error < 0 ? -error : -FLASH_FILE_KIND].expected);
	return false;
}

/* Writes the memory from `offset` on to `file`. Returns 0 or an errno. */
static int flash_file_write(const struct flash_file *flash, int file, size_t offset, size_t size)
{
	while (size > 0) {
		const ssize_t written = pwrite(file, flash->bytes + offset, size, (off_t)offset);
		if (written < 0 && errno == EINTR)
			continue;
		if (written <= 0)
			return written < 0 ? errno : EIO;
		offset += (size_t)written;
		size -= (size_t)written;
	}
	return 0;
}

/* Writes all of the memory, in space that is reserved first: a full disk is met here and not later. */
static int flash_file_write_all(const struct flash_file *flash, int file)
{
	const int error = posix_fallocate(file, 0, NF_FLASH_BYTES);

	return error ? error : flash_file_write(flash, file, 0, NF_FLASH_BYTES);
}

/* Makes the file beside its name and gives it the name when it is whole, unless another program was quicker. Returns 0
 * or an errno; then the file is not there. */
static int flash_file_make(struct flash_file *flash)
{
	char aside[PATH_MAX];
	const char *slash = strrchr(flash->path, '/');
	const int folder = slash ? (int)(slash - flash->path) + 1 : 0;

	if (snprintf(aside, sizeof aside, "%.*s" NEW_NAME, folder, flash->path) >= (int)sizeof aside)
		return ENAMETOOLONG;
	const int file = mkostemp(aside, O_CLOEXEC);
	if (file < 0)
		return errno;
	const mode_t mask = umask(0);
	umask(mask);
	int error = flash_file_write_all(flash, file);
	if (!error && (fchmod(file, MODE & ~mask) != 0 || flock(file, LOCK_EX | LOCK_NB) != 0 || fsync(file) != 0))
		error = errno;
	if (!error && renameat2(AT_FDCWD, aside, AT_FDCWD, flash->path, RENAME_NOREPLACE) != 0)
		error = errno;
	if (error == EINVAL || error == ENOSYS) /* a file system without RENAME_NOREPLACE */
		error = rename(aside, flash->path) == 0 ? 0 : errno;
	if (error) {
		unlink(aside);
		close(file);
		return error;
	}
	flash->file = file;
	return 0;
}

static bool flash_file_has_dead_sector(const uint8_t *bytes)
{
	for (size_t i = 0; i < NF_FLASH_SECTORS_COUNT; ++i) {
		const uint8_t *sector = bytes + (flash_sectors[i].address - NF_FLASH_BASE);
		if (sector[0] == 0 && memcmp(sector, sector + 1, flash_sectors[i].size - 1) == 0)
			return true;
	}
	return false;
}

/* Locks the open file and reads it. Returns 0, an errno or an error of our own. */
static int flash_file_take(struct flash_file *flash)
{
	struct stat facts;

	if (fstat(flash->file, &facts) != 0)
		return errno;
	if (!S_ISREG(facts.st_mode))
		return FLASH_FILE_KIND;
	if (facts.st_size != NF_FLASH_BYTES)
		return FLASH_FILE_SIZE;
	if (flock(flash->file, LOCK_EX | LOCK_NB) != 0)
		return errno == EWOULDBLOCK ? FLASH_FILE_USED : errno;
	for (size_t at = 0; at < NF_FLASH_BYTES;) {
		const ssize_t got = pread(flash->file, flash->bytes + at, NF_FLASH_BYTES - at, (off_t)at);
		if (got < 0 && errno == EINTR)
			continue;
		if (got <= 0)
			return got < 0 ? errno : FLASH_FILE_SIZE;
		at += (size_t)got;
	}
	if (flash_file_has_dead_sector(flash->bytes))
		return FLASH_FILE_ZEROS;
	/* A file with holes takes its space now. */
	return posix_fallocate(flash->file, 0, NF_FLASH_BYTES);
}

bool flash_file_open(struct flash_file *flash, const char *path, void (*install)(uint8_t *bytes))
{
	const struct sigaction ignore = { .sa_handler = SIG_IGN };
	int error = 0;

	*flash = (struct flash_file){ .path = path ? path : "(memory)", .file = -1 };
	flash->bytes = mmap(NULL, NF_FLASH_BYTES, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
	if (flash->bytes == MAP_FAILED)
		return flash_file_refused(flash, errno);
	memset(flash->bytes, ERASED_BYTE, NF_FLASH_BYTES);
	install(flash->bytes);
	if (!path)
		return true;
	sigaction(SIGXFSZ, &ignore, NULL); /* a limit of file sizes is then an error like a full disk */
	flash->file = open(path, O_RDWR | O_CLOEXEC | O_NONBLOCK);
	if (flash->file < 0 && errno == ENOENT) {
		error = flash_file_make(flash);
		if (!error)
			return true;
		if (error != EEXIST)
			return flash_file_refused(flash, error);
		flash->file = open(path, O_RDWR | O_CLOEXEC | O_NONBLOCK); /* another program was quicker */
	}
	error = flash->file < 0 ? errno : flash_file_take(flash);
	if (!error)
		return true;
	if (flash->file >= 0)
		close(flash->file);
	flash->file = -1;
	return flash_file_refused(flash, error);
}

/* Brings `size` bytes of memory from `offset` on to the file; all of them if somebody cut it short, or if an earlier
 * change did not reach it. Returns whether the file has them. */
static bool flash_file_keep(struct flash_file *flash, size_t offset, size_t size)
{
	struct stat facts;

	if (flash->file < 0)
		return true;
	int error = fstat(flash->file, &facts) != 0 ? errno : facts.st_nlink == 0 ? ENOENT : 0;
	if (!error && (flash->behind || facts.st_size != NF_FLASH_BYTES))
		error = ftruncate(flash->file, NF_FLASH_BYTES) != 0 ? errno : flash_file_write_all(flash, flash->file);
	else if (!error)
		error = flash_file_write(flash, flash->file, offset, size);
	flash->behind = error != 0;
	if (error && !flash->complained)
		fprintf(stderr, "neuroflight: flash file %s: %s; what is changed now is not kept\n", flash->path,
			strerror(error));
	flash->complained |= error != 0;
	return !error;
}

static const uint8_t *flash_file_callback_at(void *context, uint32_t address)
{
	const struct flash_file *flash = context;

	return flash_at(&flash->model, address);
}

static bool flash_file_callback_erase(void *context, unsigned sector)
{
	struct flash_file *flash = context;
	const bool erased = flash_erase(&flash->model, sector);

	if (sector >= NF_FLASH_SECTORS_COUNT)
		return false;
	return flash_file_keep(flash, flash_sectors[sector].address - NF_FLASH_BASE, flash_sectors[sector].size) &&
	       erased;
}

static bool flash_file_callback_program(void *context, uint32_t address, const void *words, size_t bytes)
{
	struct flash_file *flash = context;
	const bool programmed = flash_program(&flash->model, address, words, bytes);
	const uint32_t offset = address - NF_FLASH_BASE;

	if (offset > NF_FLASH_BYTES || bytes > NF_FLASH_BYTES - offset)
		return false;
	return flash_file_keep(flash, offset, bytes) && programmed;
}

struct flash flash_file_interface(struct flash_file *flash, const struct flash *model)
{
	flash->model = *model;
	return (struct flash){ .context = flash,
			       .at = flash_file_callback_at,
			       .erase = flash_file_callback_erase,
			       .program = flash_file_callback_program };
}
