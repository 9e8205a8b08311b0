#include "storage/flash_chip/flash_chip.h"

#include <string.h>

#include "nf_contract.h"

/* Milliseconds. */
#define SEARCH_MS 250u   /* between two looks for a chip */
#define PROGRAM_MS 100u  /* 5 at most (M25P16), and of a status register 15 */
#define ERASE_MS 10000u  /* a block of 64 KB: 3000 at most (M25P16), 2000 (W25Q) */

#define STEPS 8u      /* transfers that a step looks at, at most */
#define SHORT_BYTES 5u /* a transfer of 3 us at most is waited for, */
#define SHORT_LOOKS 64u /* and so often looked at */
#define CHUNK_BYTES 512u
#define ID_BYTES 5u
#define RELEASED 0xFFu

enum {
	WRITE_STATUS = 0x01,
	PROGRAM = 0x02, /* NAND: into the page buffer, all else of which becomes 0xFF */
	READ = 0x03,    /* NAND: from the page buffer */
	READ_STATUS = 0x05,
	WRITE_ENABLE = 0x06,
	EXECUTE = 0x10,   /* NAND: programs the page buffer */
	LOAD_PAGE = 0x13, /* NAND: into the page buffer */
	PROGRAM_MORE = 0x84, /* NAND: into the page buffer, all else of which stays */
	IDENTIFY = 0x9F,
	FOUR_BYTES = 0xB7, /* addresses have four */
	SELECT_DIE = 0xC2,
	ERASE = 0xD8,
};
/* Status of both kinds, then NAND's alone. */
enum { BUSY = 0x01, ENABLED = 0x02, ERASE_BAD = 0x04, PROGRAM_BAD = 0x08, ECC = 0x30, ECC_BAD = 0x20 };
/* Bits of a NOR chip's status that protect blocks, whoever made it (BP, TB, SEC): elsewhere one of them switches on four data
 * lines, which are not used. */
#define PROTECTED 0x7Cu
/* NAND's registers (W25N01GV, 7.1 to 7.3). */
enum {
	NAND_PROTECTION = 0xA0,
	NAND_CONFIGURATION = 0xB0,
	NAND_STATUS = 0xC0,
	NAND_CORRECTS = 0x10,
	NAND_BUFFERED = 0x08
};

enum flash_phase {
	FLASH_ABSENT,
	FLASH_IDENTIFY,
	FLASH_DIE,
	FLASH_ENABLE,
	FLASH_ENABLED,  /* is it? */
	FLASH_LOAD,     /* NAND: of its page buffer, or from it */
	FLASH_COMMAND,
	FLASH_POLL,     /* until the chip is at rest */
	FLASH_REST,
};
/* The first ones set up each die. */
enum flash_job { SETUP_STATUS, SETUP_UNPROTECT, SETUP_ADDRESS, SETUP_CORRECT, JOB_READ, JOB_PROGRAM, JOB_ERASE };

/* NOR chips by maker and type; the third byte of the identity is their size. All have pages of 256 bytes and blocks of 64 KB
 * that 0xD8 erases. */
static const uint8_t nor[][2] = {
	{ 0xEF, 0x40 }, { 0xEF, 0x70 }, { 0xEF, 0x60 }, { 0xEF, 0x80 }, { 0xEF, 0x30 }, /* Winbond W25Q, W25X */
	{ 0xEF, 0x71 }, /* Winbond W25M: two of them in one */
	{ 0xC8, 0x40 }, /* GigaDevice GD25Q */
	{ 0xC2, 0x20 }, /* Macronix MX25L */
	{ 0x20, 0x20 }, { 0x20, 0xBA }, /* Micron M25P, N25Q and MT25QL */
	{ 0x20, 0x40 }, { 0x20, 0x60 }, { 0x20, 0x70 }, /* XMC XM25QH */
	{ 0x85, 0x20 }, { 0x85, 0x60 }, /* Puya PY25Q, P25Q */
	{ 0x5E, 0x40 }, /* Zbit ZB25VQ */
	{ 0x0B, 0x40 }, /* XTX XT25F */
	{ 0x68, 0x40 }, { 0xE0, 0x40 }, /* Boya BY25Q, and BergMicro */
	{ 0xA1, 0x40 }, /* Fudan FM25Q */
	{ 0xC4, 0x60 }, { 0x1C, 0x71 }, /* Giantec GT25Q */
	{ 0xBA, 0x60 }, /* Zetta ZD25WQ */
	{ 0x01, 0x60 }, /* Cypress S25FL-L */
};
/* Powers of two; Winbond counts on in decimal digits. Micron's 64 MB ask for another status, too, and are left out. */
enum { SIZE_LEAST = 0x14, SIZE_OLD_MOST = 0x17, SIZE_MOST = 0x1A, SIZE_64_MB = 0x20 };
enum { NOR_PAGE = 256, NOR_PAGES = 256, NAND_PAGE = 2048, NAND_PAGES = 64 };
#define THREE_BYTES (1u << 24) /* bytes that addresses of three reach */

/* NAND chips: pages of 2048 bytes and 64 more, blocks of 64 pages. */
static const struct {
	uint8_t identity[3];
	uint8_t dies;
	uint16_t blocks; /* of all dies */
} nand[] = {
	{ { 0xEF, 0xAA, 0x21 }, 1, 1024 }, /* W25N01G */
	{ { 0xEF, 0xAE, 0x21 }, 1, 1024 }, /* W25N01K */
	{ { 0xEF, 0xAA, 0x22 }, 1, 2048 }, /* W25N02K */
	{ { 0xEF, 0xAB, 0x21 }, 2, 2048 }, /* W25M02G */
};

/* Begins a phase that time ends. */
static void chip_enter(struct flash_chip *chip, enum flash_phase phase)
{
	chip->phase = phase;
	chip->since = chip->bus->milliseconds(chip->bus->context);
}

static uint32_t chip_passed(const struct flash_chip *chip)
{
	return chip->bus->milliseconds(chip->bus->context) - chip->since;
}

/* Exchanges `count` bytes, the first of which is `command`. */
static void chip_send(struct flash_chip *chip, uint8_t command, size_t count)
{
	chip->bus->bytes[0] = command;
	chip->moving = true;
	chip->quick = count <= SHORT_BYTES;
	chip->bus->select(chip->bus->context, true);
	chip->bus->start(chip->bus->context, count);
}

/* Puts `value` behind the command, in `count` bytes. */
static void chip_put(struct flash_chip *chip, uint32_t value, unsigned count)
{
	uint8_t *const bytes = chip->bus->bytes + 1;

	for (unsigned i = 0; i < count; ++i)
		bytes[i] = (uint8_t)(value >> 8u * (count - 1u - i));
}

static void chip_ask_status(struct flash_chip *chip)
{
	chip_put(chip, NAND_STATUS, chip->nand);
	chip->bus->bytes[1 + chip->nand] = RELEASED; /* busy, if nothing answers */
	chip_send(chip, READ_STATUS, chip->nand ? 3u : 2u);
}

static void chip_end(struct flash_chip *chip)
{
	chip->outcome = chip->failed ? FLASH_FAILED : FLASH_DONE;
	chip->phase = FLASH_REST;
}

static void chip_lose(struct flash_chip *chip, enum nf_log_error error)
{
	chip->outcome = FLASH_FAILED;
	chip->error = error;
	chip->blocks = 0;
	chip_enter(chip, FLASH_ABSENT);
}

/* ---- a job ---- */

/* Where the job's page, or the block that it begins, lies in its die. */
static uint32_t chip_address(const struct flash_chip *chip)
{
	const uint32_t page = chip->page % (chip->blocks * chip->pages / chip->dies);

	return chip->nand ? page : page * NOR_PAGE + chip->column + chip->moved;
}

/* Bytes of the job that the next transfer takes. */
static size_t chip_part(const struct flash_chip *chip)
{
	const size_t left = (size_t)chip->count - chip->moved;

	return left < CHUNK_BYTES ? left : CHUNK_BYTES;
}

/* Bytes to or from a NAND chip's page buffer. */
static void chip_load(struct flash_chip *chip)
{
	const size_t part = chip_part(chip);
	const uint32_t column = chip->column + chip->moved;
	uint8_t command = READ;

	chip->phase = FLASH_LOAD;
	chip_put(chip, column, 2);
	if (chip->job == JOB_PROGRAM) {
		command = chip->moved == 0u ? PROGRAM : PROGRAM_MORE;
		chip->fill(chip->context, column, chip->bus->bytes + 3, part);
	}
	chip_send(chip, command, (chip->job == JOB_PROGRAM ? 3u : 4u) + part);
}

/* The command that the job is for. */
static void chip_command(struct flash_chip *chip)
{
	static const uint8_t values[] = { [SETUP_UNPROTECT] = 0, [SETUP_CORRECT] = NAND_CORRECTS | NAND_BUFFERED };
	const unsigned address_bytes = chip->address_bytes;
	uint8_t *const data = chip->bus->bytes + 1u + address_bytes;
	size_t part = 0;

	chip->phase = FLASH_COMMAND;
	switch ((enum flash_job)chip->job) {
	case SETUP_UNPROTECT:
	case SETUP_CORRECT:
		chip_put(chip, chip->job == SETUP_CORRECT ? NAND_CONFIGURATION : NAND_PROTECTION, chip->nand);
		chip->bus->bytes[1 + chip->nand] = values[chip->job];
		chip_send(chip, WRITE_STATUS, chip->nand ? 3u : 2u);
		return;
	case SETUP_ADDRESS:
		chip_send(chip, FOUR_BYTES, 1);
		return;
	case JOB_READ:
		part = chip->nand ? 0u : chip_part(chip);
		chip_put(chip, chip_address(chip), address_bytes);
		chip_send(chip, chip->nand ? LOAD_PAGE : READ, 1u + address_bytes + part);
		return;
	case JOB_PROGRAM:
		if (!chip->nand) {
			part = chip->count;
			chip->fill(chip->context, chip->column, data, part);
		}
		chip_put(chip, chip_address(chip), address_bytes);
		chip_send(chip, chip->nand ? EXECUTE : PROGRAM, 1u + address_bytes + part);
		return;
	default:
		chip_put(chip, chip_address(chip), address_bytes);
		chip_send(chip, ERASE, 1u + address_bytes);
		return;
	}
}

/* Begins the job, once its die listens. */
static void chip_begin(struct flash_chip *chip)
{
	if (chip->job == SETUP_STATUS) {
		chip_enter(chip, FLASH_POLL);
		chip_ask_status(chip);
	} else if (chip->job != JOB_READ) {
		chip->phase = FLASH_ENABLE;
		chip_send(chip, WRITE_ENABLE, 1);
	} else if (chip->nand && chip->cached == chip->page) {
		chip_load(chip);
	} else {
		chip->cached = chip->page;
		chip_command(chip);
	}
}

static void chip_select_die(struct flash_chip *chip, uint8_t die)
{
	chip->die = die;
	chip->cached = FLASH_NO_PAGE;
	chip->phase = FLASH_DIE;
	chip_put(chip, die, 1);
	chip_send(chip, SELECT_DIE, 2);
}

/* The job's command has been carried out, with that status. */
static void chip_done(struct flash_chip *chip, uint8_t status)
{
	static const uint8_t bad[] = { [JOB_READ] = ECC_BAD, [JOB_PROGRAM] = PROGRAM_BAD, [JOB_ERASE] = ERASE_BAD };
	static const uint8_t looked[] = { [JOB_READ] = ECC, [JOB_PROGRAM] = PROGRAM_BAD, [JOB_ERASE] = ERASE_BAD };

	if (chip->job >= JOB_READ) {
		chip->failed = chip->nand && (status & looked[chip->job]) == bad[chip->job];
		if (chip->failed)
			chip->cached = FLASH_NO_PAGE;
		if (chip->job == JOB_READ)
			chip_load(chip);
		else
			chip_end(chip);
		return;
	}
	/* What is next in the setup of a die? */
	if (chip->job == SETUP_STATUS && (chip->nand || (status & PROTECTED) != 0u)) {
		chip->job = SETUP_UNPROTECT;
	} else if (chip->job < SETUP_ADDRESS && !chip->nand && chip->address_bytes == 4u) {
		chip->job = SETUP_ADDRESS;
	} else if (chip->job == SETUP_UNPROTECT && chip->nand) {
		chip->job = SETUP_CORRECT;
	} else if (chip->die + 1u < chip->dies) {
		chip->job = SETUP_STATUS;
		chip_select_die(chip, chip->die + 1u);
		return;
	} else {
		chip->error = NF_LOG_ERROR_NONE;
		chip_end(chip);
		return;
	}
	chip_begin(chip);
}

/* ---- which one it is ---- */

static bool chip_is_nor(const uint8_t identity[3])
{
	const bool old = identity[0] == 0x20u && identity[1] == 0x20u; /* M25P; the largest one has blocks of 256 KB */

	for (unsigned i = 0; i < sizeof nor / sizeof nor[0]; ++i)
		if (memcmp(identity, nor[i], sizeof nor[i]) == 0)
			return (identity[2] >= SIZE_LEAST && identity[2] <= (old ? SIZE_OLD_MOST : SIZE_MOST)) ||
			       (identity[2] == SIZE_64_MB && identity[0] == 0xEFu);
	return false;
}

/* NAND's identity comes behind a byte for nothing (W25N01GV, 8.2.2). */
static void chip_identified(struct flash_chip *chip, const uint8_t *answer)
{
	if (chip_is_nor(answer)) {
		const uint32_t bytes = 1u << (answer[2] == SIZE_64_MB ? 26u : answer[2]);

		chip->nand = false;
		chip->page_bytes = NOR_PAGE;
		chip->pages = NOR_PAGES;
		chip->dies = answer[1] == 0x71u ? 2u : 1u;
		chip->blocks = bytes / (NOR_PAGE * NOR_PAGES) * chip->dies;
		chip->address_bytes = bytes > THREE_BYTES ? 4u : 3u;
	}
	for (unsigned i = 0; i < sizeof nand / sizeof nand[0]; ++i) {
		if (memcmp(answer + 1, nand[i].identity, sizeof nand[i].identity) != 0)
			continue;
		chip->nand = true;
		chip->page_bytes = NAND_PAGE;
		chip->pages = NAND_PAGES;
		chip->dies = nand[i].dies;
		chip->blocks = nand[i].blocks;
		chip->address_bytes = 3;
	}
	if (chip->blocks == 0u) {
		const bool silent = answer[0] == answer[1] && (answer[0] == 0u || answer[0] == RELEASED);

		chip_lose(chip, silent ? NF_LOG_ERROR_NO_CARD : NF_LOG_ERROR_CHIP);
		return;
	}
	chip->job = SETUP_STATUS;
	if (chip->dies > 1u)
		chip_select_die(chip, 0);
	else
		chip_begin(chip);
}

/* ---- what has come ---- */

/* Bytes of a read have come behind `head` others. */
static void chip_take(struct flash_chip *chip, size_t head)
{
	const size_t part = chip_part(chip);

	memcpy(chip->bytes + chip->moved, chip->bus->bytes + head, part);
	chip->moved = (uint16_t)(chip->moved + part);
	if (chip->moved == chip->count)
		chip_end(chip);
	else if (chip->nand)
		chip_load(chip);
	else
		chip_command(chip);
}

/* A transfer has ended. Returns whether there is more to do at once. */
static bool chip_sent(struct flash_chip *chip)
{
	const uint8_t *const bytes = chip->bus->bytes;
	const uint8_t status = bytes[chip->nand ? 2 : 1];

	switch ((enum flash_phase)chip->phase) {
	case FLASH_IDENTIFY:
		chip_identified(chip, bytes + 1);
		return true;
	case FLASH_DIE:
		chip_begin(chip);
		return true;
	case FLASH_ENABLE:
		chip->phase = FLASH_ENABLED;
		chip_ask_status(chip);
		return true;
	case FLASH_ENABLED:
		chip->failed = (status & ENABLED) == 0u && chip->job >= JOB_READ;
		if (chip->failed)
			chip_end(chip);
		else if (chip->nand && chip->job == JOB_PROGRAM)
			chip_load(chip);
		else
			chip_command(chip);
		return true;
	case FLASH_LOAD:
		if (chip->job == JOB_READ) {
			chip_take(chip, 4);
			return true;
		}
		chip->moved = (uint16_t)(chip->moved + chip_part(chip));
		if (chip->moved == chip->count)
			chip_command(chip);
		else
			chip_load(chip);
		return true;
	case FLASH_COMMAND:
		if (chip->job == JOB_READ && !chip->nand) {
			chip_take(chip, 1u + chip->address_bytes);
			return true;
		}
		chip_enter(chip, FLASH_POLL);
		chip_ask_status(chip);
		return true;
	default: /* FLASH_POLL */
		if ((status & BUSY) == 0u) {
			chip_done(chip, status);
			return true;
		}
		if (chip_passed(chip) > (chip->job == JOB_ERASE || chip->job == SETUP_STATUS ? ERASE_MS : PROGRAM_MS))
			chip_lose(chip, NF_LOG_ERROR_WRITE);
		return false;
	}
}

/* Has the transfer ended? A quick one is waited for. */
static bool chip_has_ended(const struct flash_chip *chip)
{
	for (unsigned looks = chip->quick ? SHORT_LOOKS : 1u; looks != 0u; --looks)
		if (chip->bus->done(chip->bus->context))
			return true;
	return false;
}

void flash_chip_init(struct flash_chip *chip, const struct spi_bus *bus, flash_fill fill, void *context)
{
	*chip = (struct flash_chip){ .bus = bus, .fill = fill, .context = context, .cached = FLASH_NO_PAGE };
	bus->speed(bus->context, true);
	chip->since = bus->milliseconds(bus->context) - SEARCH_MS;
}

void flash_chip_step(struct flash_chip *chip)
{
	for (unsigned steps = STEPS; steps != 0u; --steps) {
		if (chip->moving) {
			if (!chip_has_ended(chip))
				return;
			chip->moving = false;
			chip->bus->select(chip->bus->context, false);
			if (!chip_sent(chip))
				return;
		} else if (chip->phase == FLASH_POLL) {
			chip_ask_status(chip);
		} else if (chip->phase == FLASH_ABSENT && chip_passed(chip) >= SEARCH_MS) {
			chip->phase = FLASH_IDENTIFY;
			memset(chip->bus->bytes, RELEASED, ID_BYTES);
			chip_send(chip, IDENTIFY, ID_BYTES);
		} else {
			return;
		}
	}
}

bool flash_chip_free(const struct flash_chip *chip)
{
	return chip->phase == FLASH_REST;
}

static void chip_start(struct flash_chip *chip, enum flash_job job, uint32_t page, uint32_t column, size_t count)
{
	const uint8_t die = (uint8_t)(page / (chip->blocks * chip->pages / chip->dies));

	chip->job = job;
	chip->page = page;
	chip->column = column;
	chip->count = (uint16_t)count;
	chip->moved = 0;
	chip->failed = false;
	chip->outcome = FLASH_PENDING;
	if (die != chip->die)
		chip_select_die(chip, die);
	else
		chip_begin(chip);
}

void flash_chip_read(struct flash_chip *chip, uint32_t page, uint32_t column, uint8_t *bytes, size_t count)
{
	chip->bytes = bytes;
	chip_start(chip, JOB_READ, page, column, count);
}

void flash_chip_program(struct flash_chip *chip, uint32_t page, uint32_t column, size_t count)
{
	chip->cached = FLASH_NO_PAGE;
	chip_start(chip, JOB_PROGRAM, page, column, count);
}

void flash_chip_erase(struct flash_chip *chip, uint32_t block)
{
	chip->cached = FLASH_NO_PAGE;
	chip_start(chip, JOB_ERASE, block * chip->pages, 0, 0);
}
