/* A USB device under any host; DISK says which: 0 the serial port, 1 the disk. Input: steps of a byte, whose lower three
 * bits tell what happens (enum step) and whose upper ones how much, and what it takes. The controller is the smallest one
 * that keeps the rules of port/usb_controller.h, and promises that the device keeps them, too. */
#include "fuzz.h"

#include "usb/usb_disk.h"
#include "usb/usb_serial.h"

#define ENDPOINTS 3u
#define FIFO_BYTES 512u
#define BLOCKS 64u

enum step { SETUP, GIVE_CONTROL, GIVE_DATA, TAKE, BUS, WORK, MEDIUM, COMMAND };

static struct wire {
	struct usb_events events;
	unsigned address;
	bool open[2 * ENDPOINTS], stalled[2 * ENDPOINTS];
	size_t sending[2 * ENDPOINTS]; /* bytes that are left + 1; 0: nothing is sent */
	uint8_t fifo[2 * ENDPOINTS][FIFO_BYTES];
	size_t sent[2 * ENDPOINTS]; /* bytes of it that the host took */
	unsigned hearing[2 * ENDPOINTS];
	uint32_t blocks; /* of the medium */
	bool late, bad;
} wire;

static unsigned place(unsigned endpoint)
{
	return (endpoint & ~USB_IN) + (endpoint & USB_IN ? ENDPOINTS : 0u);
}

static void wire_address(void *context, unsigned address)
{
	PROMISE(address < 128);
	wire.address = address;
}

static void wire_open(void *context, unsigned endpoint, enum usb_kind kind, size_t packet_bytes)
{
	PROMISE((endpoint & ~USB_IN) != 0 && (endpoint & ~USB_IN) < ENDPOINTS && !wire.open[place(endpoint)]);
	PROMISE((kind == USB_BULK && packet_bytes == USB_PACKET_BYTES) || (kind == USB_INTERRUPT && packet_bytes == 16));
	wire.open[place(endpoint)] = true;
}

static void wire_close(void *context)
{
	for (unsigned i = 0; i < 2 * ENDPOINTS; ++i) {
		if (i == 0 || i == ENDPOINTS)
			continue;
		wire.open[i] = wire.stalled[i] = false;
		wire.sending[i] = 0;
		wire.hearing[i] = 0;
	}
}

static size_t wire_send(void *context, unsigned endpoint, const uint8_t *bytes, size_t count)
{
	const unsigned i = place(endpoint);
	const size_t part = count < FIFO_BYTES ? count : FIFO_BYTES;

	PROMISE((endpoint & USB_IN) != 0 && wire.open[i] && wire.sending[i] == 0);
	PROMISE(endpoint != USB_IN || count <= USB_PACKET_BYTES);
	if (part > 0)
		memcpy(wire.fifo[i], bytes, part);
	wire.sending[i] = part + 1;
	wire.sent[i] = 0;
	return part;
}

static void wire_drop(void *context, unsigned endpoint)
{
	PROMISE((endpoint & USB_IN) != 0);
	wire.sending[place(endpoint)] = 0;
}

static void wire_receive(void *context, unsigned endpoint, unsigned packets)
{
	PROMISE((endpoint & USB_IN) == 0 && wire.open[place(endpoint)] && packets > 0);
	if (endpoint == 0 || wire.hearing[endpoint] == 0)
		wire.hearing[endpoint] = packets;
}

static void wire_stall(void *context, unsigned endpoint, bool stalls)
{
	PROMISE(wire.open[place(endpoint)]);
	wire.stalled[place(endpoint)] = stalls;
	if (endpoint == 0)
		wire.stalled[ENDPOINTS] = stalls;
}

static const struct usb_controller controller = {
	.address = wire_address,
	.open = wire_open,
	.close = wire_close,
	.send = wire_send,
	.drop = wire_drop,
	.receive = wire_receive,
	.stall = wire_stall,
};

/* --- The host ----------------------------------------------------------------------------------------------------------- */
static void setup(const uint8_t bytes[USB_SETUP_BYTES])
{
	wire.stalled[0] = wire.stalled[ENDPOINTS] = false;
	wire.hearing[0] = 0;
	wire.events.setup(wire.events.context, bytes);
	PROMISE(wire.stalled[0] || wire.sending[ENDPOINTS] > 0 || wire.hearing[0] > 0); /* it never waits for ever */
}

/* Returns whether the device took the packet. */
static bool give(unsigned endpoint, const uint8_t *bytes, size_t count)
{
	if (wire.stalled[endpoint] || wire.hearing[endpoint] == 0)
		return false;
	--wire.hearing[endpoint];
	const bool over = wire.hearing[endpoint] == 0 || count < USB_PACKET_BYTES;
	if (over)
		wire.hearing[endpoint] = 0;
	wire.events.received(wire.events.context, endpoint, bytes, count);
	if (over)
		wire.events.ended(wire.events.context, endpoint);
	return true;
}

/* Returns the bytes of a packet of the device; -1: it has none. */
static int take(unsigned endpoint, uint8_t packet[USB_PACKET_BYTES])
{
	const unsigned i = ENDPOINTS + endpoint;

	if (wire.stalled[i] || wire.sending[i] == 0)
		return -1;
	const size_t left = wire.sending[i] - 1 - wire.sent[i];
	const size_t part = left < USB_PACKET_BYTES ? left : USB_PACKET_BYTES;
	memcpy(packet, wire.fifo[i] + wire.sent[i], part);
	wire.sent[i] += part;
	if (part == left) {
		wire.sending[i] = 0;
		wire.events.ended(wire.events.context, USB_IN | endpoint);
	}
	return (int)part;
}

static void reset(void)
{
	for (unsigned i = 0; i < 2 * ENDPOINTS; ++i) {
		wire.stalled[i] = false;
		wire.sending[i] = 0;
		wire.hearing[i] = 0;
	}
	wire.events.reset(wire.events.context);
	for (unsigned i = 0; i < 2 * ENDPOINTS; ++i)
		PROMISE(wire.open[i] == (i == 0 || i == ENDPOINTS));
}

/* A request without data to the device. Returns whether it was carried out. */
static bool told(unsigned type, unsigned request, unsigned value)
{
	const uint8_t bytes[USB_SETUP_BYTES] = { (uint8_t)type, (uint8_t)request, (uint8_t)value };
	uint8_t packet[USB_PACKET_BYTES];

	setup(bytes);
	return take(0, packet) == 0;
}

static void enumerate(void)
{
	static const uint8_t describe[USB_SETUP_BYTES] = { USB_IN, 6, 0, 1, 0, 0, 18, 0 };
	uint8_t packet[USB_PACKET_BYTES];

	reset();
	setup(describe);
	PROMISE(take(0, packet) == 18 && packet[0] == 18 && packet[1] == 1);
	PROMISE(give(0, packet, 0));
	PROMISE(told(0, 5, 9) && wire.address == 9);
	PROMISE(told(0, 9, 1) && wire.open[1] && wire.open[ENDPOINTS + 1]);
}

/* --- What the device is for ------------------------------------------------------------------------------------------------ */
static uint32_t medium_blocks(void *context)
{
	return wire.blocks;
}

static enum usb_medium_answer medium_read(void *context, uint32_t block, uint8_t bytes[USB_DISK_BLOCK_BYTES])
{
	PROMISE(wire.blocks == 0 || block < BLOCKS);
	if (wire.bad || wire.blocks == 0)
		return USB_MEDIUM_FAILED;
	if (wire.late)
		return USB_MEDIUM_LATER;
	memset(bytes, (int)block, USB_DISK_BLOCK_BYTES);
	return USB_MEDIUM_DONE;
}

static const struct usb_medium medium = { .blocks = medium_blocks, .read = medium_read };

struct world {
	struct usb_device device;
	struct usb_function function;
	struct usb_serial serial;
	struct usb_disk disk;
	struct serial_line line;
};

static struct world *world_new(void)
{
	static const struct usb_texts texts = { "maker", "product", "serial" };
	struct world *const world = calloc(1, sizeof *world);

	if (!world)
		abort();
	memset(&wire, 0, sizeof wire);
	wire.open[0] = wire.open[ENDPOINTS] = true;
	wire.blocks = BLOCKS;
	if (DISK)
		usb_disk_init(&world->disk, &world->device, &controller, &medium, &world->function);
	else
		usb_serial_init(&world->serial, &controller, &world->function);
	world->line = usb_serial_line(&world->serial);
	wire.events = usb_device_init(&world->device, &controller, &world->function, &texts);
	return world;
}

/* The firmware's turn: it reads some, and says some. */
static void work(struct world *world, unsigned amount)
{
	const struct serial_line *const line = &world->line;
	uint8_t bytes[64];
	size_t room;

	if (DISK) {
		usb_disk_step(&world->disk);
		return;
	}
	(void)line->look(line->context);
	const size_t waiting = line->waiting(line->context), count = line->read(line->context, bytes, amount);
	PROMISE(waiting <= USB_SERIAL_RING_BYTES && count == (waiting < amount ? waiting : amount));
	uint8_t *const words = line->room(line->context, &room);
	PROMISE(room <= USB_SERIAL_SEND_BYTES);
	if (amount % 2 == 1) {
		memset(words, 'x', room);
		line->fill(line->context, room);
	}
	line->send(line->context);
}

static void command(struct input *input, unsigned amount)
{
	uint8_t bytes[USB_DISK_COMMAND_BYTES] = { 'U', 'S', 'B', 'C' };

	bytes[8] = (uint8_t)input_byte(input);
	bytes[9] = (uint8_t)input_byte(input);
	bytes[12] = amount % 2 == 1 ? USB_IN : 0;
	bytes[14] = 10;
	for (unsigned i = 0; i < 10; ++i)
		bytes[15 + i] = (uint8_t)input_byte(input);
	(void)give(1, bytes, sizeof bytes);
}

/* --- After whatever came ----------------------------------------------------------------------------------------------------- */
static void expect_service(struct world *world)
{
	uint8_t packet[USB_PACKET_BYTES] = { 'U', 'S', 'B', 'C', 7 };

	enumerate();
	wire.blocks = BLOCKS;
	if (DISK) {
		packet[14] = 6;
		PROMISE(give(1, packet, USB_DISK_COMMAND_BYTES));
		usb_disk_step(&world->disk);
		PROMISE(take(1, packet) == (int)USB_DISK_STATUS_BYTES && packet[4] == 7 && packet[12] <= 1);
		return;
	}
	PROMISE(give(1, packet, 5));
	PROMISE(world->line.look(world->line.context) == SERIAL_LINE_NEW);
	PROMISE(world->line.read(world->line.context, packet, sizeof packet) == 5 && packet[4] == 7);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	struct input input = { data, size };
	struct world *const world = world_new();
	uint8_t packet[USB_PACKET_BYTES];

	enumerate();
	while (input.left > 0) {
		const unsigned step = input_byte(&input), amount = step >> 3;
		size_t count = step % 8 == SETUP ? USB_SETUP_BYTES : 0;

		switch ((enum step)(step % 8)) {
		case SETUP: {
			uint8_t bytes[USB_SETUP_BYTES] = { 0 };
			uint8_t *const came = input_bytes(&input, &count);
			memcpy(bytes, came, count);
			free(came);
			setup(bytes);
			break;
		}
		case GIVE_CONTROL:
		case GIVE_DATA: {
			count = input_byte(&input) % (USB_PACKET_BYTES + 1);
			uint8_t *const bytes = input_bytes(&input, &count);
			(void)give(step % 8 == GIVE_DATA, bytes, count);
			free(bytes);
			break;
		}
		case TAKE:
			for (unsigned i = 0; i <= amount / 3; ++i)
				(void)take(amount % 3, packet);
			break;
		case BUS:
			if (amount % 4 == 0)
				reset();
			else if (amount % 4 == 1)
				enumerate();
			else
				wire.events.suspend(wire.events.context, amount % 4 == 2);
			break;
		case WORK:
			work(world, amount);
			break;
		case MEDIUM:
			wire.blocks = amount % 2 == 1 ? BLOCKS : 0;
			wire.late = (amount & 2) != 0;
			wire.bad = (amount & 4) != 0;
			break;
		case COMMAND:
			command(&input, amount);
			break;
		}
	}
	expect_service(world);
	free(world);
	return 0;
}
