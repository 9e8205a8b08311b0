#include "usb/usb_device.h"

#include <string.h>

/* bmRequestType (USB 2.0, 9.3). */
enum { TYPE_MASK = 0x60, TYPE_STANDARD = 0x00, TYPE_CLASS = 0x20, RECIPIENT_MASK = 0x1F };
enum { TO_DEVICE = 0, TO_INTERFACE = 1, TO_ENDPOINT = 2 };
/* bRequest (9.4). */
enum {
	GET_STATUS = 0,
	CLEAR_FEATURE = 1,
	SET_FEATURE = 3,
	SET_ADDRESS = 5,
	GET_DESCRIPTOR = 6,
	GET_CONFIGURATION = 8,
	SET_CONFIGURATION = 9,
	GET_INTERFACE = 10,
	SET_INTERFACE = 11,
};
enum { ENDPOINT_HALT = 0 };         /* 9.4, table 9-6 */
enum { SELF_POWERED = 1 };          /* GET_STATUS of the device */
enum { LANGUAGE = 0x0409 };         /* US English */
enum { TEXT_LANGUAGES, TEXT_MAKER, TEXT_PRODUCT, TEXT_SERIAL };
enum { CONFIGURATION = 1 };         /* the only one's number */
enum { HALF_OF_STALLED = 8 };       /* bits of `stalled` a direction */
/* Places in descriptors. */
enum {
	TOTAL_LENGTH = 2,
	INTERFACES = 4,
	INTERFACE_NUMBER = 2,
	ENDPOINT_ADDRESS = 2,
	ENDPOINT_KIND = 3,
	PACKET_SIZE = 4
};

static uint16_t device_word(const uint8_t *bytes)
{
	return (uint16_t)(bytes[0] | bytes[1] << 8);
}

static bool device_to_host(const struct usb_setup *setup)
{
	return (setup->type & USB_IN) != 0u;
}

/* --- Endpoints of the configuration ------------------------------------------------------------------------------ */
/* The next endpoint's descriptor behind `at`; NULL: there is none. *interface: whose it is. */
static const uint8_t *device_next_endpoint(const struct usb_device *device, const uint8_t *at, unsigned *interface)
{
	const uint8_t *const begin = device->function->configuration, *const end = begin +
										   device_word(begin + TOTAL_LENGTH);

	for (at = at == NULL ? begin : at + at[0]; at < end; at += at[0]) {
		if (at[1] == USB_INTERFACE_DESCRIPTOR)
			*interface = at[INTERFACE_NUMBER];
		else if (at[1] == USB_ENDPOINT_DESCRIPTOR)
			return at;
	}
	return NULL;
}

static bool device_has_endpoint(const struct usb_device *device, unsigned endpoint)
{
	unsigned interface;

	for (const uint8_t *at = NULL; (at = device_next_endpoint(device, at, &interface)) != NULL;)
		if (at[ENDPOINT_ADDRESS] == endpoint)
			return true;
	return false;
}

static uint16_t device_bit(unsigned endpoint)
{
	return (uint16_t)(1u << ((endpoint & 7u) + ((endpoint & USB_IN) != 0u ? HALF_OF_STALLED : 0u)));
}

static void device_set_stall(struct usb_device *device, unsigned endpoint, bool stalls)
{
	const uint16_t bit = device_bit(endpoint);

	device->stalled = (uint16_t)(stalls ? device->stalled | bit : device->stalled & ~bit);
	device->controller->stall(device->controller->context, endpoint, stalls);
}

void usb_device_stall(struct usb_device *device, unsigned endpoint)
{
	device_set_stall(device, endpoint, true);
}

/* Also ends it, and begins it anew. */
static void device_configure(struct usb_device *device, bool configured)
{
	const struct usb_function *const function = device->function;
	const struct usb_controller *const controller = device->controller;
	unsigned interface;

	if (device->configured) {
		controller->close(controller->context);
		function->configure(function->context, false);
	}
	device->configured = configured;
	device->stalled = 0;
	if (!configured)
		return;
	for (const uint8_t *at = NULL; (at = device_next_endpoint(device, at, &interface)) != NULL;)
		controller->open(controller->context, at[ENDPOINT_ADDRESS], (enum usb_kind)at[ENDPOINT_KIND],
				 device_word(at + PACKET_SIZE));
	function->configure(function->context, true);
}

/* --- Standard requests: each returns whether it is one, and for data to the host what, by `at` and `left` --------- */
static bool device_reply(struct usb_device *device, const void *bytes, size_t count)
{
	device->at = bytes;
	device->left = (uint16_t)count;
	return true;
}

static bool device_reply_byte(struct usb_device *device, unsigned value)
{
	device->data[0] = (uint8_t)value;
	return device_reply(device, device->data, 1);
}

static bool device_reply_status(struct usb_device *device, unsigned status)
{
	device->data[0] = (uint8_t)status;
	device->data[1] = 0;
	return device_reply(device, device->data, 2);
}

/* Characters of two bytes (9.6.7). */
static bool device_reply_text(struct usb_device *device, const char *text)
{
	uint8_t *const bytes = device->data;
	size_t count = 2;

	for (unsigned i = 0; i < USB_TEXT_MAX && text[i] != '\0'; ++i) {
		bytes[count++] = (uint8_t)text[i];
		bytes[count++] = 0;
	}
	bytes[0] = (uint8_t)count;
	bytes[1] = USB_STRING_DESCRIPTOR;
	return device_reply(device, bytes, count);
}
_Static_assert(2u + 2u * USB_TEXT_MAX <= USB_CONTROL_BYTES, "a text has room");

static bool device_string(struct usb_device *device, unsigned number)
{
	static const uint8_t languages[] = { 4, USB_STRING_DESCRIPTOR, USB_LOW(LANGUAGE), USB_HIGH(LANGUAGE) };

	switch (number) {
	case TEXT_LANGUAGES:
		return device_reply(device, languages, sizeof languages);
	case TEXT_MAKER:
		return device_reply_text(device, device->texts->maker);
	case TEXT_PRODUCT:
		return device_reply_text(device, device->texts->product);
	case TEXT_SERIAL:
		return device_reply_text(device, device->texts->serial);
	default:
		return false;
	}
}

static bool device_descriptor(struct usb_device *device)
{
	const struct usb_function *const function = device->function;
	const unsigned kind = USB_HIGH(device->setup.value), number = USB_LOW(device->setup.value);

	if (kind == USB_DEVICE_DESCRIPTOR && number == 0u)
		return device_reply(device, function->device, USB_DEVICE_BYTES);
	if (kind == USB_CONFIGURATION_DESCRIPTOR && number == 0u)
		return device_reply(device, function->configuration,
				    device_word(function->configuration + TOTAL_LENGTH));
	return kind == USB_STRING_DESCRIPTOR && device_string(device, number);
}

static bool device_set_configuration(struct usb_device *device)
{
	const unsigned number = device->setup.value;

	if (number > CONFIGURATION || device->address == 0u)
		return false;
	device_configure(device, number == CONFIGURATION);
	return true;
}

static bool device_set_address(struct usb_device *device)
{
	if (device->setup.value > 127u || device->configured)
		return false;
	device->address = (uint8_t)device->setup.value;
	device->controller->address(device->controller->context, device->address);
	return true;
}

static bool device_asked(struct usb_device *device)
{
	const struct usb_setup *const setup = &device->setup;

	if (setup->request == GET_DESCRIPTOR)
		return device_to_host(setup) && device_descriptor(device);
	if (setup->index != 0u)
		return false;
	if (device_to_host(setup)) {
		if (setup->value != 0u)
			return false;
		if (setup->request == GET_STATUS)
			return device_reply_status(device, SELF_POWERED);
		return setup->request == GET_CONFIGURATION &&
		       device_reply_byte(device, device->configured ? CONFIGURATION : 0u);
	}
	if (setup->length != 0u)
		return false;
	if (setup->request == SET_ADDRESS)
		return device_set_address(device);
	return setup->request == SET_CONFIGURATION && device_set_configuration(device);
}

/* SET_INTERFACE: what its endpoints sent and took before is over, so they begin with DATA0 (9.4.10, 9.1.1.5). */
static bool device_begin_interface(struct usb_device *device)
{
	const struct usb_function *const function = device->function;
	unsigned interface = 0;

	for (const uint8_t *at = NULL; (at = device_next_endpoint(device, at, &interface)) != NULL;)
		if (interface == device->setup.index && function->cleared(function->context, at[ENDPOINT_ADDRESS]))
			device_set_stall(device, at[ENDPOINT_ADDRESS], false);
	return true;
}

static bool device_interface_asked(struct usb_device *device)
{
	const struct usb_setup *const setup = &device->setup;

	if (!device->configured || setup->value != 0u || setup->index >= device->function->configuration[INTERFACES])
		return false;
	if (device_to_host(setup)) {
		if (setup->request == GET_STATUS)
			return device_reply_status(device, 0);
		return setup->request == GET_INTERFACE && device_reply_byte(device, 0);
	}
	return setup->request == SET_INTERFACE && setup->length == 0u && device_begin_interface(device);
}

static bool device_endpoint_asked(struct usb_device *device)
{
	const struct usb_function *const function = device->function;
	const struct usb_setup *const setup = &device->setup;
	const unsigned endpoint = setup->index;
	const bool control = (endpoint & ~USB_IN) == 0u;

	if (setup->value != ENDPOINT_HALT ||
	    !(control || (device->configured && device_has_endpoint(device, endpoint))))
		return false;
	if (device_to_host(setup))
		return setup->request == GET_STATUS &&
		       device_reply_status(device, !control && (device->stalled & device_bit(endpoint)) != 0u);
	if (setup->length != 0u)
		return false;
	if (setup->request == CLEAR_FEATURE) {
		if (!control && function->cleared(function->context, endpoint))
			device_set_stall(device, endpoint, false);
		return true;
	}
	if (setup->request != SET_FEATURE || control)
		return false;
	device_set_stall(device, endpoint, true);
	return true;
}

/* --- Requests ---------------------------------------------------------------------------------------------------- */
static bool device_class_asked(struct usb_device *device)
{
	const struct usb_function *const function = device->function;
	const struct usb_setup *const setup = &device->setup;
	size_t count = device->taken;

	if ((setup->type & RECIPIENT_MASK) != TO_INTERFACE || !device->configured ||
	    setup->index >= function->configuration[INTERFACES] ||
	    !function->request(function->context, setup, device->data, &count))
		return false;
	if (device_to_host(setup))
		(void)device_reply(device, device->data, count);
	return true;
}

static bool device_carried_out(struct usb_device *device)
{
	const unsigned type = device->setup.type;

	if ((type & TYPE_MASK) == TYPE_CLASS)
		return device_class_asked(device);
	if ((type & TYPE_MASK) != TYPE_STANDARD)
		return false;
	switch (type & RECIPIENT_MASK) {
	case TO_DEVICE:
		return device_asked(device);
	case TO_INTERFACE:
		return device_interface_asked(device);
	case TO_ENDPOINT:
		return device_endpoint_asked(device);
	default:
		return false;
	}
}

static void device_refuse(struct usb_device *device)
{
	device->stage = USB_IDLE;
	device->controller->stall(device->controller->context, 0, true);
}

static void device_send(struct usb_device *device)
{
	const size_t part = device->left < USB_PACKET_BYTES ? device->left : USB_PACKET_BYTES;

	(void)device->controller->send(device->controller->context, USB_IN, device->at, part);
	device->at += part;
	device->left = (uint16_t)(device->left - part);
	device->empty &= part == USB_PACKET_BYTES;
}

static void device_hear(struct usb_device *device)
{
	device->controller->receive(device->controller->context, 0, 1);
}

/* Data go to the host, which may end them early by its status; or the device tells that all is well. */
static void device_answer(struct usb_device *device)
{
	device->left = 0;
	if (!device_carried_out(device)) {
		device_refuse(device);
		return;
	}
	if (!device_to_host(&device->setup) || device->setup.length == 0u) {
		device->left = 0;
		device->empty = false;
		device->stage = USB_STATUS_IN;
	} else {
		device->empty = device->left < device->setup.length;
		if (device->left > device->setup.length)
			device->left = device->setup.length;
		device->stage = USB_DATA_IN;
		device_hear(device);
	}
	device_send(device);
}

static void device_setup(void *context, const uint8_t bytes[USB_SETUP_BYTES])
{
	struct usb_device *const device = context;

	if (device->stage == USB_DATA_IN || device->stage == USB_STATUS_IN)
		device->controller->drop(device->controller->context, USB_IN);
	device->setup = (struct usb_setup){
		.type = bytes[0],
		.request = bytes[1],
		.value = device_word(bytes + 2),
		.index = device_word(bytes + 4),
		.length = device_word(bytes + 6),
	};
	device->taken = 0;
	if (device_to_host(&device->setup) || device->setup.length == 0u) {
		device_answer(device);
	} else if ((device->setup.type & TYPE_MASK) != TYPE_CLASS || device->setup.length > USB_CONTROL_BYTES) {
		device_refuse(device); /* no standard request brings data that this device takes */
	} else {
		device->stage = USB_DATA_OUT;
		device->left = device->setup.length;
		device_hear(device);
	}
}

static void device_take(struct usb_device *device, const uint8_t *bytes, size_t count)
{
	if (count > device->left || (count < device->left && count != USB_PACKET_BYTES)) {
		device_refuse(device);
		return;
	}
	memcpy(device->data + device->taken, bytes, count);
	device->taken = (uint16_t)(device->taken + count);
	device->left = (uint16_t)(device->left - count);
	if (device->left == 0u)
		device_answer(device);
	else
		device_hear(device);
}

static void device_received(void *context, unsigned endpoint, const uint8_t *bytes, size_t count)
{
	struct usb_device *const device = context;
	const struct usb_function *const function = device->function;

	if (endpoint != 0u) {
		if (device->configured)
			function->received(function->context, endpoint, bytes, count);
	} else if (device->stage == USB_DATA_OUT) {
		device_take(device, bytes, count);
	} else if (device->stage == USB_DATA_IN || device->stage == USB_STATUS_OUT) {
		if (device->stage == USB_DATA_IN)
			device->controller->drop(device->controller->context, USB_IN);
		device->stage = USB_IDLE;
		if (count != 0u)
			device_refuse(device);
	}
}

static void device_ended(void *context, unsigned endpoint)
{
	struct usb_device *const device = context;
	const struct usb_function *const function = device->function;

	if ((endpoint & ~USB_IN) != 0u) {
		if (device->configured)
			function->ended(function->context, endpoint);
	} else if (endpoint == USB_IN && device->stage == USB_DATA_IN) {
		if (device->left > 0u || device->empty)
			device_send(device);
		else
			device->stage = USB_STATUS_OUT;
	} else if (endpoint == USB_IN && device->stage == USB_STATUS_IN) {
		device->stage = USB_IDLE;
	}
}

static void device_reset(void *context)
{
	struct usb_device *const device = context;

	device_configure(device, false);
	device->address = 0;
	device->stage = USB_IDLE;
}

static void device_suspend(void *context, bool paused)
{
	struct usb_device *const device = context;

	if (device->configured)
		device->function->suspend(device->function->context, paused);
}

struct usb_events usb_device_init(struct usb_device *device, const struct usb_controller *controller,
				  const struct usb_function *function, const struct usb_texts *texts)
{
	*device = (struct usb_device){ .controller = controller, .function = function, .texts = texts };
	return (struct usb_events){
		.context = device,
		.reset = device_reset,
		.suspend = device_suspend,
		.setup = device_setup,
		.received = device_received,
		.ended = device_ended,
	};
}
