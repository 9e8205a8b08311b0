#include "usb/usb_disk.h"

#include <string.h>

enum { DATA_IN = USB_IN | 1u, DATA_OUT = 1u };
enum { CLASS_STORAGE = 8, SCSI = 6, BULK_ONLY = 0x50, INTERFACES = 1 };
enum { RESET = 0xFF, GET_MAX_LUN = 0xFE }; /* Bulk-Only Transport, 3.1 and 3.2 */
enum { PASSED = 0, FAILED = 1, PHASE_ERROR = 2 }; /* 5.2 */

/* Places in a command and a status (Bulk-Only Transport, 5.1 and 5.2). */
enum {
	COMMAND_TAG = 4,
	COMMAND_LENGTH = 8,
	COMMAND_FLAGS = 12,
	COMMAND_UNIT = 13,
	COMMAND_SIZE = 14,
	COMMAND_BLOCK = 15
};
enum { COMMAND_SIZE_MAX = 16, STATUS_TAG = 4, STATUS_RESIDUE = 8, STATUS_STATUS = 12 };
static const uint8_t command_signature[] = { 'U', 'S', 'B', 'C' };
static const uint8_t status_signature[] = { 'U', 'S', 'B', 'S' };

/* SCSI operations (SPC-2, SBC). */
enum {
	TEST_UNIT_READY = 0x00,
	REQUEST_SENSE = 0x03,
	INQUIRY = 0x12,
	MODE_SENSE_6 = 0x1A,
	START_STOP_UNIT = 0x1B,
	PREVENT_REMOVAL = 0x1E,
	READ_FORMAT_CAPACITIES = 0x23,
	READ_CAPACITY = 0x25,
	READ_10 = 0x28,
	WRITE_10 = 0x2A,
	SYNCHRONIZE_CACHE = 0x35,
	MODE_SENSE_10 = 0x5A,
};
/* Sense keys and additional sense codes (SPC-2, 7.20). */
enum { NO_SENSE = 0, NOT_READY = 2, MEDIUM_ERROR = 3, ILLEGAL_REQUEST = 5, UNIT_ATTENTION = 6, DATA_PROTECT = 7 };
enum {
	NO_REASON = 0,
	READ_ERROR = 0x11,
	UNKNOWN_OPERATION = 0x20,
	BLOCK_OUT_OF_RANGE = 0x21,
	INVALID_FIELD = 0x24,
	WRITE_PROTECTED = 0x27,
	MEDIUM_CHANGED = 0x28,
	NO_MEDIUM = 0x3A,
};
enum { LOAD_EJECT = 2, START = 1 }; /* START STOP UNIT, byte 4 */
enum { VITAL_DATA = 1 };            /* INQUIRY, byte 1: EVPD */
enum { PROTECTED = 0x80 };          /* mode parameter header, WP */

static const uint8_t device_descriptor[] = USB_DEVICE_OF(0, 0, 0, USB_DISK_PRODUCT);
_Static_assert(sizeof device_descriptor == USB_DEVICE_BYTES, "its length");

#define CONFIGURATION_BYTES 32
static const uint8_t configuration[] = {
	USB_CONFIGURATION_OF(CONFIGURATION_BYTES, INTERFACES),
	USB_INTERFACE_OF(0, 2, CLASS_STORAGE, SCSI, BULK_ONLY),
	USB_ENDPOINT_OF(DATA_OUT, USB_BULK, USB_PACKET_BYTES, 0),
	USB_ENDPOINT_OF(DATA_IN, USB_BULK, USB_PACKET_BYTES, 0),
};
_Static_assert(sizeof configuration == CONFIGURATION_BYTES, "its length");

/* A removable disk (SPC-2, 7.3.2): vendor, product and revision, filled with spaces. */
static const uint8_t inquiry[USB_DISK_REPLY_BYTES] = {
	0,   0x80, 4,   2,   USB_DISK_REPLY_BYTES - 5u,
	0,   0,    0,   'N', 'e',
	'u', 'r',  'o', 'f', 'l',
	'i', 'S',  'D', ' ', 'c',
	'a', 'r',  'd', ' ', 'r',
	'e', 'a',  'd', ' ', 'o',
	'n', 'l',  '1', '.', '0',
	' ',
};

static uint32_t disk_word(const uint8_t *bytes)
{
	return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

/* SCSI's numbers begin with the highest byte. */
static uint32_t disk_number(const uint8_t *bytes)
{
	return __builtin_bswap32(disk_word(bytes));
}

static void disk_put_number(uint8_t *bytes, uint32_t number)
{
	for (unsigned i = 0; i < 4u; ++i)
		bytes[i] = (uint8_t)(number >> (24u - 8u * i));
}

static void disk_put_word(uint8_t *bytes, uint32_t word)
{
	disk_put_number(bytes, __builtin_bswap32(word));
}

static void disk_hear(struct usb_disk *disk)
{
	if (disk->hears)
		return;
	disk->hears = true;
	disk->controller->receive(disk->controller->context, DATA_OUT, 1);
}

static void disk_wait(struct usb_disk *disk)
{
	disk->stage = USB_DISK_COMMAND;
	disk_hear(disk);
}

/* --- Outcomes ------------------------------------------------------------------------------------------------------ */
static void disk_finish(struct usb_disk *disk, unsigned status)
{
	disk->status = (uint8_t)status;
	disk->stage = USB_DISK_STATUS;
}

static void disk_fail(struct usb_disk *disk, unsigned sense, unsigned reason)
{
	disk->sense = (uint8_t)sense;
	disk->reason = (uint8_t)reason;
	disk_finish(disk, FAILED);
}

/* Is there a medium? Where there is a new one, the host is told once. */
static bool disk_is_ready(struct usb_disk *disk)
{
	if (disk->ejected || disk->medium->blocks(disk->medium->context) == 0u) {
		disk->seen = false;
		disk_fail(disk, NOT_READY, NO_MEDIUM);
		return false;
	}
	if (disk->seen)
		return true;
	disk->seen = true;
	disk_fail(disk, UNIT_ATTENTION, MEDIUM_CHANGED);
	return false;
}

/* `count` of disk->bytes, as many as the host has room for. */
static void disk_reply(struct usb_disk *disk, size_t count, size_t allocated)
{
	const size_t most = allocated < disk->expected ? allocated : disk->expected;

	disk->filled = (uint16_t)(count < most ? count : most);
	disk->sent = 0;
	disk->stage = USB_DISK_REPLY;
}

/* --- Commands -------------------------------------------------------------------------------------------------------- */
static void disk_inquire(struct usb_disk *disk, const uint8_t *command)
{
	if ((command[1] & VITAL_DATA) != 0u || command[2] != 0u) {
		disk_fail(disk, ILLEGAL_REQUEST, INVALID_FIELD);
		return;
	}
	memcpy(disk->bytes, inquiry, sizeof inquiry);
	disk_reply(disk, sizeof inquiry, (size_t)command[3] << 8 | command[4]);
}

/* In the fixed format (SPC-2, 7.20.2). What was told is forgotten. */
static void disk_tell_sense(struct usb_disk *disk, const uint8_t *command)
{
	enum { CURRENT = 0x70, KEY = 2, MORE = 7, CODE = 12, SENSE_BYTES = 18 };

	memset(disk->bytes, 0, SENSE_BYTES);
	disk->bytes[0] = CURRENT;
	disk->bytes[KEY] = disk->sense;
	disk->bytes[MORE] = SENSE_BYTES - MORE - 1;
	disk->bytes[CODE] = disk->reason;
	disk->sense = NO_SENSE;
	disk->reason = NO_REASON;
	disk_reply(disk, SENSE_BYTES, command[4]);
}

/* A header without pages: it says that nothing can be written. */
static void disk_tell_mode(struct usb_disk *disk, size_t bytes, unsigned place, size_t allocated)
{
	memset(disk->bytes, 0, bytes);
	disk->bytes[bytes == 4u ? 0 : 1] = (uint8_t)(bytes - (bytes == 4u ? 1u : 2u));
	disk->bytes[place] = PROTECTED;
	disk_reply(disk, bytes, allocated);
}

static void disk_tell_capacity(struct usb_disk *disk)
{
	if (!disk_is_ready(disk))
		return;
	disk_put_number(disk->bytes, disk->medium->blocks(disk->medium->context) - 1u);
	disk_put_number(disk->bytes + 4, USB_DISK_BLOCK_BYTES);
	disk_reply(disk, 8, SIZE_MAX);
}

/* One descriptor: that of the medium (MMC, READ FORMAT CAPACITIES), which Windows asks for. */
static void disk_tell_formats(struct usb_disk *disk, const uint8_t *command)
{
	enum { FORMATTED = 2 };

	if (!disk_is_ready(disk))
		return;
	memset(disk->bytes, 0, 4);
	disk->bytes[3] = 8;
	disk_put_number(disk->bytes + 4, disk->medium->blocks(disk->medium->context));
	disk_put_number(disk->bytes + 8, FORMATTED << 24 | USB_DISK_BLOCK_BYTES);
	disk_reply(disk, 12, (size_t)command[7] << 8 | command[8]);
}

static void disk_read(struct usb_disk *disk, const uint8_t *command)
{
	const uint32_t block = disk_number(command + 2), blocks = (uint32_t)command[7] << 8 | command[8];

	if (!disk_is_ready(disk))
		return;
	const uint32_t all = disk->medium->blocks(disk->medium->context);

	if (block > all || blocks > all - block) {
		disk_fail(disk, ILLEGAL_REQUEST, BLOCK_OUT_OF_RANGE);
	} else if (blocks * USB_DISK_BLOCK_BYTES > disk->expected) {
		disk_finish(disk, PHASE_ERROR);
	} else {
		disk->block = block;
		disk->blocks = blocks;
		disk->filled = 0;
		disk->sent = 0;
		disk->stage = USB_DISK_BLOCKS;
	}
}

static void disk_start_or_stop(struct usb_disk *disk, const uint8_t *command)
{
	if ((command[4] & LOAD_EJECT) != 0u)
		disk->ejected = (command[4] & START) == 0u;
	disk_finish(disk, PASSED);
}

static void disk_carry_out(struct usb_disk *disk, const uint8_t *command)
{
	switch (command[0]) {
	case INQUIRY:
		disk_inquire(disk, command);
		break;
	case REQUEST_SENSE:
		disk_tell_sense(disk, command);
		break;
	case MODE_SENSE_6:
		disk_tell_mode(disk, 4, 2, command[4]);
		break;
	case MODE_SENSE_10:
		disk_tell_mode(disk, 8, 3, (size_t)command[7] << 8 | command[8]);
		break;
	case START_STOP_UNIT:
		disk_start_or_stop(disk, command);
		break;
	case TEST_UNIT_READY:
		if (disk_is_ready(disk))
			disk_finish(disk, PASSED);
		break;
	case PREVENT_REMOVAL:
	case SYNCHRONIZE_CACHE:
		disk_finish(disk, PASSED);
		break;
	case READ_CAPACITY:
		disk_tell_capacity(disk);
		break;
	case READ_FORMAT_CAPACITIES:
		disk_tell_formats(disk, command);
		break;
	case READ_10:
		disk_read(disk, command);
		break;
	case WRITE_10:
		disk_fail(disk, DATA_PROTECT, WRITE_PROTECTED);
		break;
	default:
		disk_fail(disk, ILLEGAL_REQUEST, UNKNOWN_OPERATION);
		break;
	}
}

/* What came where a command belongs. */
static void disk_take(struct usb_disk *disk, const uint8_t *bytes, size_t count)
{
	const bool valid = count == USB_DISK_COMMAND_BYTES &&
			   memcmp(bytes, command_signature, sizeof command_signature) == 0 &&
			   bytes[COMMAND_UNIT] == 0u && bytes[COMMAND_SIZE] != 0u &&
			   bytes[COMMAND_SIZE] <= COMMAND_SIZE_MAX;

	if (!valid) {
		disk->stage = USB_DISK_LOST;
		usb_device_stall(disk->device, DATA_IN);
		usb_device_stall(disk->device, DATA_OUT);
		return;
	}
	const uint32_t told = disk_word(bytes + COMMAND_LENGTH);
	const bool brings = told != 0u && (bytes[COMMAND_FLAGS] & USB_IN) == 0u;

	disk->tag = disk_word(bytes + COMMAND_TAG);
	disk->expected = brings ? 0u : told;
	disk->filled = 0;
	disk->sent = 0;
	disk->told_end = brings;
	disk_carry_out(disk, bytes + COMMAND_BLOCK);
	if (!brings)
		return;
	/* No command takes data: one that has some for the host does not agree with it (Bulk-Only Transport, 6.7.3). */
	if (disk->stage != USB_DISK_STATUS)
		disk_finish(disk, PHASE_ERROR);
	disk->expected = told;
	usb_device_stall(disk->device, DATA_OUT);
}

/* --- The way of a command --------------------------------------------------------------------------------------------- */
static void disk_send(struct usb_disk *disk)
{
	const size_t part = disk->controller->send(disk->controller->context, DATA_IN, disk->bytes + disk->sent,
						   (size_t)disk->filled - disk->sent);

	disk->sends = part != 0u;
	disk->sent = (uint16_t)(disk->sent + part);
	if (disk->stage == USB_DISK_ENDING)
		return;
	disk->expected -= (uint32_t)part;
	disk->told_end = part % USB_PACKET_BYTES != 0u;
}

static void disk_read_on(struct usb_disk *disk)
{
	switch (disk->medium->read(disk->medium->context, disk->block, disk->bytes)) {
	case USB_MEDIUM_LATER:
		break;
	case USB_MEDIUM_FAILED:
		disk_fail(disk, MEDIUM_ERROR, READ_ERROR);
		break;
	case USB_MEDIUM_DONE:
		++disk->block;
		--disk->blocks;
		disk->filled = USB_DISK_BLOCK_BYTES;
		disk->sent = 0;
		disk_send(disk);
		break;
	}
}

/* A host that waits for more data than there are is told by a short packet, or else by STALL (6.7.2). */
static void disk_tell_status(struct usb_disk *disk)
{
	if (disk->expected != 0u && !disk->told_end) {
		disk->told_end = true;
		disk->stalls = true;
		usb_device_stall(disk->device, DATA_IN);
		return;
	}
	memcpy(disk->bytes, status_signature, sizeof status_signature);
	disk_put_word(disk->bytes + STATUS_TAG, disk->tag);
	disk_put_word(disk->bytes + STATUS_RESIDUE, disk->expected);
	disk->bytes[STATUS_STATUS] = disk->status;
	disk->filled = USB_DISK_STATUS_BYTES;
	disk->sent = 0;
	disk->stage = USB_DISK_ENDING;
	disk_send(disk);
}

void usb_disk_step(struct usb_disk *disk)
{
	if (!disk->configured || disk->sends || disk->stalls)
		return;
	switch (disk->stage) {
	case USB_DISK_REPLY:
		if (disk->sent < disk->filled)
			disk_send(disk);
		else
			disk_finish(disk, PASSED);
		break;
	case USB_DISK_BLOCKS:
		if (disk->sent < disk->filled)
			disk_send(disk);
		else if (disk->blocks != 0u)
			disk_read_on(disk);
		else
			disk_finish(disk, PASSED);
		break;
	case USB_DISK_STATUS:
		disk_tell_status(disk);
		break;
	case USB_DISK_ENDING:
		if (disk->sent < disk->filled)
			disk_send(disk);
		else
			disk_wait(disk);
		break;
	default:
		break;
	}
}

/* --- As a function of the device ---------------------------------------------------------------------------------------- */
static void disk_configure(void *context, bool configured)
{
	struct usb_disk *const disk = context;

	disk->configured = configured;
	disk->hears = false;
	disk->sends = false;
	disk->stalls = false;
	disk->stage = USB_DISK_COMMAND;
	disk->seen = false;
	if (configured)
		disk_wait(disk);
}

static void disk_suspend(void *context, bool paused)
{
}

static bool disk_request(void *context, const struct usb_setup *setup, uint8_t *data, size_t *count)
{
	struct usb_disk *const disk = context;
	const bool to_host = (setup->type & USB_IN) != 0u;

	if (setup->value != 0u)
		return false;
	if (setup->request == GET_MAX_LUN && to_host && setup->length == 1u) {
		data[0] = 0;
		*count = 1;
		return true;
	}
	if (setup->request != RESET || to_host || setup->length != 0u)
		return false;
	if (disk->sends)
		disk->controller->drop(disk->controller->context, DATA_IN);
	disk->sends = false;
	disk->stalls = false;
	disk_wait(disk);
	return true;
}

static void disk_received(void *context, unsigned endpoint, const uint8_t *bytes, size_t count)
{
	struct usb_disk *const disk = context;

	disk->hears = false;
	if (disk->stage == USB_DISK_COMMAND)
		disk_take(disk, bytes, count);
}

static void disk_ended(void *context, unsigned endpoint)
{
	struct usb_disk *const disk = context;

	if (endpoint != DATA_IN)
		return;
	disk->sends = false;
	usb_disk_step(disk);
}

/* Of an endpoint that answers STALL as what came was no command: only the reset before it. */
static bool disk_cleared(void *context, unsigned endpoint)
{
	struct usb_disk *const disk = context;

	if (disk->stage == USB_DISK_LOST)
		return false;
	if (endpoint == DATA_IN)
		disk->stalls = false;
	return true;
}

void usb_disk_init(struct usb_disk *disk, struct usb_device *device, const struct usb_controller *controller,
		   const struct usb_medium *medium, struct usb_function *function)
{
	*disk = (struct usb_disk){ .device = device, .controller = controller, .medium = medium };
	*function = (struct usb_function){
		.context = disk,
		.device = device_descriptor,
		.configuration = configuration,
		.configure = disk_configure,
		.suspend = disk_suspend,
		.request = disk_request,
		.received = disk_received,
		.ended = disk_ended,
		.cleared = disk_cleared,
	};
}
