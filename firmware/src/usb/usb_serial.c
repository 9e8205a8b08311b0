#include "usb/usb_serial.h"

#include <string.h>

enum { DATA_IN = USB_IN | 1u, DATA_OUT = 1u, NOTICE_IN = USB_IN | 2u };
enum { CONTROL_INTERFACE = 0, DATA_INTERFACE = 1, INTERFACES = 2 };
enum { CLASS_MISC = 0xEF, CLASS_COMMUNICATIONS = 2, CLASS_DATA = 10 };
enum { ABSTRACT_CONTROL = 2, AT_COMMANDS = 1 }; /* CDC 1.2, tables 4 and 5 */
enum { CS_INTERFACE = 0x24, HEADER = 0, CALL_MANAGEMENT = 1, ACM = 2, UNION = 6 };
enum { SET_LINE_CODING = 0x20, GET_LINE_CODING = 0x21, SET_CONTROL_LINE_STATE = 0x22 }; /* PSTN 1.2, 6.3 */
enum { LINE_REQUESTS = 2 };   /* bmCapabilities of ACM: the three requests above */
enum { TERMINAL_READY = 1 };  /* D0 of SET_CONTROL_LINE_STATE */
enum { STOP_BITS_2 = 2, PARITY_SPACE = 4 }; /* the last numbers of their kinds */
enum { NOTICE_BYTES = 16, NOTICE_MS = 255 }; /* none is sent */
#define PACKETS_MAX (USB_SERIAL_RING_BYTES / 2u / USB_PACKET_BYTES) /* that the host may send at once */
_Static_assert((USB_SERIAL_RING_BYTES & (USB_SERIAL_RING_BYTES - 1u)) == 0u, "counts of bytes wrap at 2^32");

/* An association tells Windows that both interfaces are one function (USB ECN "Interface Association"; its class triple
 * is the device's, by which the system's composite driver is chosen). */
static const uint8_t device_descriptor[] = USB_DEVICE_OF(CLASS_MISC, 2, 1, USB_SERIAL_PRODUCT);
_Static_assert(sizeof device_descriptor == USB_DEVICE_BYTES, "its length");

#define CONFIGURATION_BYTES 75
static const uint8_t configuration[] = {
	USB_CONFIGURATION_OF(CONFIGURATION_BYTES, INTERFACES),
	8,
	USB_ASSOCIATION_DESCRIPTOR,
	CONTROL_INTERFACE,
	INTERFACES,
	CLASS_COMMUNICATIONS,
	ABSTRACT_CONTROL,
	AT_COMMANDS,
	0,
	USB_INTERFACE_OF(CONTROL_INTERFACE, 1, CLASS_COMMUNICATIONS, ABSTRACT_CONTROL, AT_COMMANDS),
	5,
	CS_INTERFACE,
	HEADER,
	USB_LOW(0x0120u),
	USB_HIGH(0x0120u),
	5,
	CS_INTERFACE,
	CALL_MANAGEMENT,
	0,
	DATA_INTERFACE,
	4,
	CS_INTERFACE,
	ACM,
	LINE_REQUESTS,
	5,
	CS_INTERFACE,
	UNION,
	CONTROL_INTERFACE,
	DATA_INTERFACE,
	USB_ENDPOINT_OF(NOTICE_IN, USB_INTERRUPT, NOTICE_BYTES, NOTICE_MS),
	USB_INTERFACE_OF(DATA_INTERFACE, 2, CLASS_DATA, 0, 0),
	USB_ENDPOINT_OF(DATA_OUT, USB_BULK, USB_PACKET_BYTES, 0),
	USB_ENDPOINT_OF(DATA_IN, USB_BULK, USB_PACKET_BYTES, 0),
};
_Static_assert(sizeof configuration == CONFIGURATION_BYTES, "its length");

/* 115200 baud, 8N1, until a host says otherwise. */
static const uint8_t coding_at_first[USB_SERIAL_CODING_BYTES] = { 0x00, 0xC2, 0x01, 0x00, 0, 0, 8 };

/* The host may send as much as there is room for, once there is room for a good part. */
static void serial_hear(struct usb_serial *serial)
{
	const uint32_t room = USB_SERIAL_RING_BYTES - (serial->head - serial->tail);

	if (!serial->configured || serial->hears || room < PACKETS_MAX * USB_PACKET_BYTES)
		return;
	serial->hears = true;
	serial->controller->receive(serial->controller->context, DATA_OUT, PACKETS_MAX);
}

/* Nothing of the last peer's is left. */
static void serial_change(struct usb_serial *serial)
{
	if (serial->sends)
		serial->controller->drop(serial->controller->context, DATA_IN);
	serial->changed = true;
	serial->sends = false;
	serial->full = false;
	serial->tail = serial->head;
	serial->looked = serial->head;
	serial->filled = 0;
	serial->sent = 0;
}

/* --- As a function of the device ---------------------------------------------------------------------------------- */
static void serial_configure(void *context, bool configured)
{
	struct usb_serial *const serial = context;

	serial_change(serial);
	serial->configured = configured;
	serial->paused = false;
	serial->asked = false;
	serial->hears = false;
	memcpy(serial->coding, coding_at_first, sizeof serial->coding);
	serial_hear(serial);
}

static void serial_suspend(void *context, bool paused)
{
	struct usb_serial *const serial = context;

	if (paused && !serial->paused)
		serial_change(serial);
	serial->paused = paused;
}

static bool serial_code(struct usb_serial *serial, const uint8_t *coding)
{
	const unsigned stop_bits = coding[4], parity = coding[5], data_bits = coding[6];

	if (stop_bits > STOP_BITS_2 || parity > PARITY_SPACE ||
	    ((data_bits < 5u || data_bits > 8u) && data_bits != 16u))
		return false;
	memcpy(serial->coding, coding, sizeof serial->coding);
	return true;
}

static bool serial_request(void *context, const struct usb_setup *setup, uint8_t *data, size_t *count)
{
	struct usb_serial *const serial = context;
	const bool to_host = (setup->type & USB_IN) != 0u;

	if (setup->index != CONTROL_INTERFACE)
		return false;
	switch (setup->request) {
	case SET_LINE_CODING:
		return !to_host && setup->value == 0u && *count == USB_SERIAL_CODING_BYTES && serial_code(serial, data);
	case GET_LINE_CODING:
		if (!to_host || setup->value != 0u)
			return false;
		memcpy(data, serial->coding, sizeof serial->coding);
		*count = sizeof serial->coding;
		return true;
	case SET_CONTROL_LINE_STATE:
		if (to_host || setup->length != 0u)
			return false;
		if (((setup->value & TERMINAL_READY) != 0u) != serial->asked)
			serial_change(serial);
		serial->asked = (setup->value & TERMINAL_READY) != 0u;
		return true;
	default:
		return false;
	}
}

static void serial_received(void *context, unsigned endpoint, const uint8_t *bytes, size_t count)
{
	struct usb_serial *const serial = context;

	/* There is room for all that the host may send; a controller that brings more loses it. */
	for (size_t i = 0; i < count && serial->head - serial->tail < USB_SERIAL_RING_BYTES; ++i)
		serial->ring[serial->head++ % USB_SERIAL_RING_BYTES] = bytes[i];
}

static void serial_send(void *context)
{
	struct usb_serial *const serial = context;
	const uint32_t left = serial->filled - serial->sent;

	serial_hear(serial);
	if (!serial->configured || serial->sends || (left == 0u && !serial->full))
		return;
	const size_t part = serial->controller->send(serial->controller->context, DATA_IN, serial->words + serial->sent,
						     left);

	serial->sends = part != 0u || left == 0u; /* else it is tried again */
	serial->full = left != 0u && part % USB_PACKET_BYTES == 0u;
	serial->sent += (uint32_t)part;
	if (serial->sent == serial->filled) {
		serial->filled = 0;
		serial->sent = 0;
	}
}

static void serial_ended(void *context, unsigned endpoint)
{
	struct usb_serial *const serial = context;

	if (endpoint == DATA_IN)
		serial->sends = false;
	else if (endpoint == DATA_OUT)
		serial->hears = false;
	serial_send(serial);
}

static bool serial_cleared(void *context, unsigned endpoint)
{
	return true;
}

void usb_serial_init(struct usb_serial *serial, const struct usb_controller *controller, struct usb_function *function)
{
	*serial = (struct usb_serial){ .controller = controller };
	memcpy(serial->coding, coding_at_first, sizeof serial->coding);
	*function = (struct usb_function){
		.context = serial,
		.device = device_descriptor,
		.configuration = configuration,
		.configure = serial_configure,
		.suspend = serial_suspend,
		.request = serial_request,
		.received = serial_received,
		.ended = serial_ended,
		.cleared = serial_cleared,
	};
}

/* --- As a line ------------------------------------------------------------------------------------------------------ */
static enum serial_news serial_look(void *context)
{
	struct usb_serial *const serial = context;
	const bool changed = serial->changed;

	serial->changed = false;
	serial->looked = serial->head;
	return changed ? SERIAL_LINE_NEW : SERIAL_LINE_GOOD;
}

static size_t serial_waiting(const void *context)
{
	const struct usb_serial *const serial = context;

	return serial->looked - serial->tail;
}

static size_t serial_read(void *context, uint8_t *bytes, size_t capacity)
{
	struct usb_serial *const serial = context;
	size_t count = 0;

	while (count < capacity && serial->tail != serial->looked)
		bytes[count++] = serial->ring[serial->tail++ % USB_SERIAL_RING_BYTES];
	return count;
}

/* Nobody reads while there is no host. */
static uint8_t *serial_room(const void *context, size_t *room)
{
	const struct usb_serial *const serial = context;

	*room = serial->configured && !serial->paused ? USB_SERIAL_SEND_BYTES - serial->filled : 0u;
	return (uint8_t *)serial->words + serial->filled;
}

static void serial_fill(void *context, size_t count)
{
	struct usb_serial *const serial = context;

	serial->filled += (uint32_t)count;
}

static bool serial_sending(const void *context)
{
	const struct usb_serial *const serial = context;

	return serial->sends || serial->filled != serial->sent || serial->full;
}

struct serial_line usb_serial_line(struct usb_serial *serial)
{
	return (struct serial_line){
		.context = serial,
		.look = serial_look,
		.waiting = serial_waiting,
		.read = serial_read,
		.room = serial_room,
		.fill = serial_fill,
		.send = serial_send,
		.sending = serial_sending,
	};
}
