#include "storage/card/sd_card.h"

#include <string.h>

#include "nf_contract.h"
#include "storage/card/sd_crc.h"

/* Milliseconds. */
#define SEARCH_MS 250u /* between two looks for a card */
#define START_MS 1000u /* of the initialisation, at most (4.2.3) */
#define READ_MS 250u   /* to the data; 100 (4.6.2.1) */
#define BUSY_MS 1000u  /* a write; 250 (4.6.2.2), what is longer is only slow */
#define ERASE_MS 60000u
#define PRESENCE_MS 500u /* at rest, between two looks whether it is still there */

#define TRIES 3u
#define COMMAND_BYTES 6u
#define RESPONSE_BYTES 9u /* the answer comes 1 to 8 bytes behind the command (7.5.1.1) */
#define WAKE_BYTES 20u    /* clocks with the select line high: 74 at least (6.4.1) */
#define POLL_BYTES 8u
#define TOKEN_BYTES 32u /* in which data's begin is looked for */
#define DATA_BYTES (SD_BLOCK_BYTES + 2u)
#define CSD_BYTES 18u
#define C_SIZE_MAX 0x3FFFFFu /* C_SIZE's 22 bits (5.3.3) */
#define NO_TOKEN UINT16_MAX
#define RELEASED 0xFFu

/* R1 (7.3.2.1). */
enum { R1_READY = 0x00, R1_IDLE = 0x01, R1_CRC = 0x08, R1_NONE = 0x80 };
/* Tokens and data responses (7.3.3). */
enum { START_READ = 0xFE, START_WRITE = 0xFC, STOP_WRITE = 0xFD };
enum { RESPONSE_MASK = 0x11, RESPONSE = 0x01, ACCEPTED = 0x05, ACCEPTED_MASK = 0x1F };
#define HIGH_CAPACITY (1u << 30)
#define INTERFACE 0x1AAu /* 2.7 to 3.6 V, and a pattern that comes back */

enum sd_phase {
	/* With a command each, by `commands`. */
	SD_RESET,
	SD_INTERFACE,
	SD_CHECKSUMS,
	SD_ANNOUNCE,
	SD_INITIALISE,
	SD_CONDITIONS,
	SD_CAPACITY,
	SD_LOOK,
	SD_READ,
	SD_OPEN,
	SD_ERASE_FIRST,
	SD_ERASE_LAST,
	SD_ERASE,
	SD_READ_ON,
	SD_STOP,
	SD_COMMANDS,

	SD_ABSENT = SD_COMMANDS, /* until the next search */
	SD_WAKE,
	SD_FLUSH, /* out of a block that was being written before a reset of the processor */
	SD_REST,
	SD_STOP_BUSY,
	SD_DATA,  /* of SD_CAPACITY, SD_READ or SD_READ_ON, by `wanted` */
	SD_BLOCK,
	SD_BLOCK_BUSY,
	SD_STUMBLED, /* a card may be busy with a block that it refused */
	SD_CLOSE,
	SD_CLOSE_BUSY,
	SD_ERASE_BUSY,
};

enum sd_job { JOB_NONE, JOB_READ, JOB_READ_ON, JOB_WRITE, JOB_ERASE, JOB_FINISH };

static const struct {
	uint8_t index, more; /* more: bytes behind R1 */
	uint32_t argument;
} commands[SD_COMMANDS] = {
	[SD_RESET] = { 0, 0, 0 },
	[SD_INTERFACE] = { 8, 4, INTERFACE },
	[SD_CHECKSUMS] = { 59, 0, 1 },
	[SD_ANNOUNCE] = { 55, 0, 0 },
	[SD_INITIALISE] = { 41, 0, HIGH_CAPACITY },
	[SD_CONDITIONS] = { 58, 4, 0 },
	[SD_CAPACITY] = { 9, 0, 0 },
	[SD_LOOK] = { 13, 1, 0 },
	[SD_READ] = { 17, 0, 0 },
	[SD_OPEN] = { 25, 0, 0 },
	[SD_ERASE_FIRST] = { 32, 0, 0 },
	[SD_ERASE_LAST] = { 33, 0, 0 },
	[SD_ERASE] = { 38, 0, 0 },
	[SD_READ_ON] = { 18, 0, 0 },
	[SD_STOP] = { 12, 0, 0 },
};

static uint32_t sd_passed(const struct sd_card *card)
{
	return card->bus->milliseconds(card->bus->context) - card->since;
}

static void sd_enter(struct sd_card *card, enum sd_phase phase)
{
	card->phase = phase;
	card->since = card->bus->milliseconds(card->bus->context);
}

static void sd_select(struct sd_card *card, bool selected)
{
	card->bus->select(card->bus->context, selected);
}

static void sd_transfer(struct sd_card *card, size_t count)
{
	card->moving = true;
	card->bus->start(card->bus->context, count);
}

/* Sends nothing, to hear. */
static void sd_listen(struct sd_card *card, size_t count)
{
	memset(card->bus->bytes, RELEASED, count);
	sd_transfer(card, count);
}

/* Sends the command of the current phase; also to repeat it. */
static void sd_send(struct sd_card *card)
{
	uint8_t *const bytes = card->bus->bytes, *const frame = bytes + 1;
	const enum sd_phase phase = card->phase;
	uint32_t argument = commands[phase].argument;

	if (phase == SD_READ || phase == SD_READ_ON || phase == SD_OPEN || phase == SD_ERASE_FIRST)
		argument = card->first;
	else if (phase == SD_ERASE_LAST)
		argument = card->last;
	memset(bytes, RELEASED, 1u + COMMAND_BYTES + RESPONSE_BYTES + commands[phase].more);
	frame[0] = (uint8_t)(0x40u | commands[phase].index);
	for (unsigned i = 0; i < 4u; ++i)
		frame[1u + i] = (uint8_t)(argument >> (24u - 8u * i));
	frame[5] = sd_crc7(frame, 5);
	sd_select(card, true);
	sd_transfer(card, 1u + COMMAND_BYTES + RESPONSE_BYTES + commands[phase].more);
}

static void sd_command(struct sd_card *card, enum sd_phase phase)
{
	if (phase != SD_ANNOUNCE && phase != SD_INITIALISE)
		sd_enter(card, phase);
	card->phase = phase;
	sd_send(card);
}

static void sd_end(struct sd_card *card, enum sd_outcome outcome)
{
	if (card->job != JOB_NONE)
		card->outcome = outcome;
	card->job = JOB_NONE;
	card->trouble = false;
	sd_enter(card, SD_REST);
}

static void sd_lose(struct sd_card *card, enum nf_log_error error)
{
	sd_select(card, false);
	sd_end(card, SD_FAILED);
	card->error = error;
	card->blocks = 0;
	card->held = SD_NO_BLOCK;
	card->writing = false;
	card->reading = false;
	sd_enter(card, SD_ABSENT);
}

static void sd_wake(struct sd_card *card)
{
	sd_select(card, false);
	card->bus->speed(card->bus->context, false);
	sd_enter(card, SD_WAKE);
	sd_listen(card, WAKE_BYTES);
}

static void sd_close(struct sd_card *card)
{
	sd_enter(card, SD_CLOSE);
	sd_select(card, true);
	memset(card->bus->bytes, RELEASED, POLL_BYTES);
	card->bus->bytes[1] = STOP_WRITE; /* then a byte passes before the card is busy (7.2.4) */
	sd_transfer(card, POLL_BYTES);
}

static void sd_send_block(struct sd_card *card)
{
	uint8_t *const bytes = card->bus->bytes;
	const uint16_t crc = sd_crc16(card->source, SD_BLOCK_BYTES);

	sd_enter(card, SD_BLOCK);
	bytes[0] = RELEASED;
	bytes[1] = START_WRITE;
	memcpy(bytes + 2, card->source, SD_BLOCK_BYTES);
	bytes[2u + SD_BLOCK_BYTES] = (uint8_t)(crc >> 8);
	bytes[3u + SD_BLOCK_BYTES] = (uint8_t)crc;
	memset(bytes + 4u + SD_BLOCK_BYTES, RELEASED, SPI_BUS_BYTES - SD_BLOCK_BYTES - 4u);
	sd_transfer(card, SPI_BUS_BYTES);
}

/* Is the job to read a block that a sequence may hold? The card's last one is not: behind it a card has no other one to
 * prepare. */
static bool sd_reads_on(const struct sd_card *card)
{
	return card->job == JOB_READ_ON && card->first + 1u < card->blocks;
}

/* Data of so many bytes are to come, behind a token. */
static void sd_await(struct sd_card *card, uint16_t wanted)
{
	card->held = SD_NO_BLOCK;
	card->wanted = wanted;
	card->taken = NO_TOKEN;
	sd_enter(card, SD_DATA);
}

/* Begins or continues the job. */
static void sd_go_on(struct sd_card *card)
{
	if (card->reading && sd_reads_on(card) && card->next == card->first && !card->trouble) {
		sd_await(card, DATA_BYTES);
		sd_listen(card, TOKEN_BYTES);
	} else if (card->reading)
		sd_command(card, SD_STOP);
	else if (card->writing && card->trouble) {
		sd_enter(card, SD_STUMBLED);
		sd_select(card, true);
		sd_listen(card, POLL_BYTES);
	} else if (card->writing && !(card->job == JOB_WRITE && card->next == card->first))
		sd_close(card);
	else if (card->trouble || card->job == JOB_FINISH)
		sd_command(card, SD_LOOK);
	else if (card->job == JOB_READ || card->job == JOB_READ_ON)
		sd_command(card, sd_reads_on(card) ? SD_READ_ON : SD_READ);
	else if (card->job == JOB_ERASE)
		sd_command(card, SD_ERASE_FIRST);
	else if (card->writing)
		sd_send_block(card);
	else
		sd_command(card, SD_OPEN);
}

/* After an error of the job, reads the card's status and then restarts the job. */
static void sd_stumble(struct sd_card *card)
{
	sd_select(card, false);
	++card->stumbles;
	card->trouble = true;
	sd_go_on(card);
}

static void sd_looked(struct sd_card *card, uint8_t r1, uint8_t more)
{
	sd_select(card, false);
	if (r1 != R1_READY)
		sd_lose(card, NF_LOG_ERROR_NO_CARD); /* or it was away meanwhile */
	else if (card->job == JOB_NONE || (card->job == JOB_FINISH && !card->trouble))
		sd_end(card, more == 0u ? SD_DONE : SD_FAILED);
	else if (card->stumbles >= TRIES)
		sd_end(card, SD_FAILED);
	else {
		card->trouble = false;
		sd_go_on(card);
	}
}

/* ---- data that are read ---- */

/* CSD of version 2 (5.3.3): C_SIZE counts 512 KiB. */
static void sd_measure(struct sd_card *card)
{
	const uint8_t *const csd = card->data;
	const uint32_t size = (uint32_t)(csd[7] & 0x3Fu) << 16 | (uint32_t)csd[8] << 8 | csd[9];

	if (csd[0] >> 6 != 1u) {
		sd_lose(card, NF_LOG_ERROR_CARD);
		return;
	}
	sd_select(card, false);
	card->bus->speed(card->bus->context, true);
	card->blocks = size < C_SIZE_MAX ? (size + 1u) << 10 : SD_NO_BLOCK; /* 2 TiB: all that fit into a word */
	card->error = NF_LOG_ERROR_NONE;
	sd_end(card, SD_DONE);
}

static void sd_data_bad(struct sd_card *card)
{
	if (card->wanted == CSD_BYTES)
		sd_lose(card, NF_LOG_ERROR_CARD);
	else
		sd_stumble(card);
}

static void sd_data_whole(struct sd_card *card)
{
	const uint16_t count = (uint16_t)(card->wanted - 2u);

	if (sd_crc16(card->data, count) != (uint16_t)(card->data[count] << 8 | card->data[count + 1u])) {
		sd_data_bad(card);
	} else if (card->wanted == CSD_BYTES) {
		sd_measure(card);
	} else {
		if (card->reading)
			++card->next; /* it stays selected */
		else
			sd_select(card, false);
		card->held = card->first;
		sd_end(card, SD_DONE);
	}
}

/* Takes what came: a token, then data. */
static void sd_collect(struct sd_card *card, const uint8_t *bytes, size_t count)
{
	for (; count != 0u && card->taken == NO_TOKEN; ++bytes, --count) {
		if (*bytes == START_READ) {
			card->taken = 0;
		} else if (*bytes != RELEASED) { /* an error token */
			sd_data_bad(card);
			return;
		}
	}
	if (card->taken == NO_TOKEN) {
		if (sd_passed(card) > READ_MS)
			sd_data_bad(card);
		else
			sd_listen(card, TOKEN_BYTES);
		return;
	}
	const size_t left = (size_t)card->wanted - card->taken, part = count < left ? count : left;

	memcpy(card->data + card->taken, bytes, part);
	card->taken = (uint16_t)(card->taken + part);
	if (part == left)
		sd_data_whole(card);
	else
		sd_listen(card, left - part);
}

static void sd_expect(struct sd_card *card, uint16_t wanted, const uint8_t *bytes, size_t count)
{
	sd_await(card, wanted);
	sd_collect(card, bytes, count);
}

/* ---- what has come ---- */

static void sd_initialising(struct sd_card *card, uint8_t r1)
{
	if (r1 == R1_READY)
		sd_command(card, SD_CONDITIONS);
	else if (r1 != R1_IDLE || sd_passed(card) > START_MS)
		sd_lose(card, NF_LOG_ERROR_CARD);
	else
		sd_command(card, SD_ANNOUNCE);
}

/* Is `r1`, and what followed it, what this phase of the initialisation asks for? */
static bool sd_is_right(enum sd_phase phase, uint8_t r1, const uint8_t *more)
{
	switch (phase) {
	case SD_INTERFACE:
		return r1 == R1_IDLE && (more[2] & 0x0Fu) == INTERFACE >> 8 && more[3] == (INTERFACE & 0xFFu);
	case SD_RESET:
	case SD_CHECKSUMS:
	case SD_ANNOUNCE:
		return r1 == R1_IDLE;
	case SD_CONDITIONS:
		return r1 == R1_READY && (more[0] & HIGH_CAPACITY >> 24) != 0u; /* others are older than SDHC */
	default:
		return r1 == R1_READY;
	}
}

static void sd_answered(struct sd_card *card, uint8_t r1, const uint8_t *more, size_t count)
{
	const enum sd_phase phase = card->phase;

	if (phase == SD_LOOK) {
		sd_looked(card, r1, more[0]);
	} else if (phase == SD_INITIALISE) {
		sd_initialising(card, r1);
	} else if (phase == SD_STOP) { /* also a card that had nothing to stop is at rest then */
		sd_enter(card, SD_STOP_BUSY);
		sd_listen(card, POLL_BYTES);
	} else if (!sd_is_right(phase, r1, more)) {
		if (phase < SD_LOOK)
			sd_lose(card, phase == SD_RESET && r1 == RELEASED ? NF_LOG_ERROR_NO_CARD : NF_LOG_ERROR_CARD);
		else
			sd_stumble(card);
	} else if (phase == SD_CAPACITY) {
		sd_expect(card, CSD_BYTES, more, count);
	} else if (phase == SD_READ) {
		sd_expect(card, DATA_BYTES, more, count);
	} else if (phase == SD_READ_ON) {
		card->reading = true;
		card->next = card->first;
		sd_expect(card, DATA_BYTES, more, count);
	} else if (phase == SD_OPEN) {
		card->writing = true;
		card->next = card->first;
		sd_send_block(card);
	} else if (phase == SD_ERASE) {
		sd_enter(card, SD_ERASE_BUSY);
		sd_listen(card, POLL_BYTES);
	} else {
		if (phase == SD_CHECKSUMS)
			sd_enter(card, SD_ANNOUNCE); /* the initialisation's time begins */
		sd_command(card, (enum sd_phase)(phase + 1));
	}
}

/* The transfer of a command has ended. */
static void sd_commanded(struct sd_card *card)
{
	const uint8_t *answer = card->bus->bytes + 1u + COMMAND_BYTES;
	const uint8_t *const last = answer + RESPONSE_BYTES - 1u, *const end = last + 1u + commands[card->phase].more;

	if (card->phase == SD_STOP)
		++answer; /* a byte of the block that was under way (7.3.1.3) */
	while (answer != last && (*answer & R1_NONE) != 0u)
		++answer;
	const bool garbled = (*answer & (R1_NONE | R1_CRC)) != 0u;

	if (garbled && ++card->tries < TRIES) {
		sd_select(card, false);
		if (card->phase == SD_RESET) {
			sd_select(card, true);
			sd_enter(card, SD_FLUSH);
			sd_listen(card, SPI_BUS_BYTES);
		} else {
			sd_send(card);
		}
		return;
	}
	card->tries = 0;
	sd_answered(card, *answer, answer + 1, (size_t)(end - answer - 1));
}

/* The card's answer to a block (7.3.3.1). */
static void sd_block_sent(struct sd_card *card)
{
	const uint8_t *answer = card->bus->bytes + 4u + SD_BLOCK_BYTES;
	const uint8_t *const last = card->bus->bytes + SPI_BUS_BYTES - 1u;

	while (answer != last && (*answer & RESPONSE_MASK) != RESPONSE)
		++answer;
	if ((*answer & ACCEPTED_MASK) != ACCEPTED) {
		sd_stumble(card);
		return;
	}
	sd_enter(card, SD_BLOCK_BUSY);
	sd_listen(card, POLL_BYTES);
}

static void sd_rested(struct sd_card *card)
{
	if (card->phase == SD_BLOCK_BUSY) {
		++card->next;
		sd_end(card, SD_DONE); /* it stays selected */
		return;
	}
	if (card->phase == SD_STUMBLED) {
		sd_close(card);
		return;
	}
	sd_select(card, false);
	card->writing = false;
	card->reading = false;
	if (card->phase == SD_ERASE_BUSY)
		card->job = JOB_FINISH; /* it has been done; was it done well? */
	if (card->job == JOB_NONE)
		sd_end(card, SD_DONE);
	else
		sd_go_on(card);
}

static void sd_transferred(struct sd_card *card)
{
	switch (card->phase) {
	case SD_WAKE:
		sd_command(card, SD_RESET);
		break;
	case SD_FLUSH:
		sd_wake(card);
		break;
	case SD_DATA:
		sd_collect(card, card->bus->bytes,
			   card->taken == NO_TOKEN ? TOKEN_BYTES : (size_t)card->wanted - card->taken);
		break;
	case SD_BLOCK:
		sd_block_sent(card);
		break;
	case SD_CLOSE:
		sd_enter(card, SD_CLOSE_BUSY);
		sd_listen(card, POLL_BYTES);
		break;
	case SD_BLOCK_BUSY:
	case SD_STUMBLED:
	case SD_CLOSE_BUSY:
	case SD_ERASE_BUSY:
	case SD_STOP_BUSY:
		if (card->bus->bytes[POLL_BYTES - 1u] == RELEASED)
			sd_rested(card);
		else if (sd_passed(card) > (card->phase == SD_ERASE_BUSY ? ERASE_MS : BUSY_MS))
			sd_lose(card, card->reading ? NF_LOG_ERROR_READ : NF_LOG_ERROR_WRITE);
		else
			sd_listen(card, POLL_BYTES);
		break;
	default:
		sd_commanded(card);
		break;
	}
}

void sd_card_init(struct sd_card *card, const struct spi_bus *bus)
{
	*card = (struct sd_card){ .bus = bus, .held = SD_NO_BLOCK };
	card->phase = SD_ABSENT;
	card->since = bus->milliseconds(bus->context) - SEARCH_MS;
}

void sd_card_step(struct sd_card *card)
{
	if (card->moving) {
		if (!card->bus->done(card->bus->context))
			return;
		card->moving = false;
		sd_transferred(card);
	} else if (card->phase == SD_ABSENT && sd_passed(card) >= SEARCH_MS) {
		sd_wake(card);
	} else if (card->phase == SD_REST && !card->writing && sd_passed(card) >= PRESENCE_MS) {
		sd_command(card, card->reading ? SD_STOP : SD_LOOK);
	}
}

bool sd_card_free(const struct sd_card *card)
{
	return card->phase == SD_REST;
}

static void sd_begin(struct sd_card *card, enum sd_job job, uint32_t first, uint32_t last)
{
	card->job = job;
	card->first = first;
	card->last = last;
	card->outcome = SD_PENDING;
	card->stumbles = 0;
	sd_go_on(card);
}

void sd_card_read(struct sd_card *card, uint32_t block)
{
	sd_begin(card, JOB_READ, block, block);
}

void sd_card_read_on(struct sd_card *card, uint32_t block)
{
	sd_begin(card, JOB_READ_ON, block, block);
}

void sd_card_write(struct sd_card *card, uint32_t block, const uint8_t *bytes)
{
	card->source = bytes;
	if (card->held == block)
		card->held = SD_NO_BLOCK;
	sd_begin(card, JOB_WRITE, block, block);
}

void sd_card_finish(struct sd_card *card)
{
	sd_begin(card, JOB_FINISH, 0, 0);
}

void sd_card_erase(struct sd_card *card, uint32_t first, uint32_t last)
{
	card->held = SD_NO_BLOCK;
	sd_begin(card, JOB_ERASE, first, last);
}
