/* A USB device as its host sees it: descriptors and standard requests of endpoint 0 (USB 2.0, chapter 9). What the device
 * is for, a class, is a usb_function.
 *
 * One configuration, no alternate settings, no remote wake-up. What is not asked for as chapter 9 says is answered with
 * STALL. */
#pragma once

#include "port/usb_controller.h"

#define USB_CONTROL_BYTES 128u /* data of a request at most, but for descriptors */
#define USB_TEXT_MAX 62u /* characters of a string descriptor */

#define USB_VENDOR 0x0483u /* STMicroelectronics, as the chip's boot loader says it */

enum usb_descriptor_type {
	USB_DEVICE_DESCRIPTOR = 1,
	USB_CONFIGURATION_DESCRIPTOR = 2,
	USB_STRING_DESCRIPTOR = 3,
	USB_INTERFACE_DESCRIPTOR = 4,
	USB_ENDPOINT_DESCRIPTOR = 5,
	USB_ASSOCIATION_DESCRIPTOR = 11,
};

#define USB_LOW(value) ((value) & 0xFFu)
#define USB_HIGH(value) ((value) >> 8 & 0xFFu)

#define USB_DEVICE_BYTES 18u
/* Texts 1 to 3 are struct usb_texts (USB 2.0, 9.6.1). */
#define USB_DEVICE_OF(class, subclass, protocol, product) \
	{ USB_DEVICE_BYTES,                               \
	  USB_DEVICE_DESCRIPTOR,                          \
	  USB_LOW(0x0200u),                               \
	  USB_HIGH(0x0200u),                              \
	  class,                                          \
	  subclass,                                       \
	  protocol,                                       \
	  USB_PACKET_BYTES,                               \
	  USB_LOW(USB_VENDOR),                            \
	  USB_HIGH(USB_VENDOR),                           \
	  USB_LOW(product),                               \
	  USB_HIGH(product),                              \
	  USB_LOW(0x0200u),                               \
	  USB_HIGH(0x0200u),                              \
	  1,                                              \
	  2,                                              \
	  3,                                              \
	  1 }
/* The board has its own supply in flight, and draws what a bus without a supply of its own has to give (9.6.3). */
#define USB_CONFIGURATION_OF(bytes, interfaces) \
	9, USB_CONFIGURATION_DESCRIPTOR, USB_LOW(bytes), USB_HIGH(bytes), interfaces, 1, 0, 0xC0, 50
#define USB_INTERFACE_OF(number, endpoints, class, subclass, protocol) \
	9, USB_INTERFACE_DESCRIPTOR, number, 0, endpoints, class, subclass, protocol, 0
#define USB_ENDPOINT_OF(address, kind, bytes, interval) \
	7, USB_ENDPOINT_DESCRIPTOR, address, kind, USB_LOW(bytes), USB_HIGH(bytes), interval

struct usb_setup {
	uint8_t type, request;
	uint16_t value, index, length;
};

/* Strings of up to USB_TEXT_MAX ASCII characters; they outlive the device. */
struct usb_texts {
	const char *maker, *product, *serial;
};

/* A class. Its endpoints are those of its configuration descriptor, each one's number below 8. */
struct usb_function {
	void *context; /* the first argument of every function */
	const uint8_t *device; /* [USB_DEVICE_BYTES] */
	const uint8_t *configuration; /* with all descriptors that belong to it */
	/* The host has chosen the configuration, endpoints are open; or that has ended. */
	void (*configure)(void *context, bool configured);
	void (*suspend)(void *context, bool paused);
	/* A request of a class, to an interface. To the device: `data` are the *count bytes that came, all that the request
	 * said. To the host: fills in up to USB_CONTROL_BYTES of it, and *count. False: answered with STALL. */
	bool (*request)(void *context, const struct usb_setup *setup, uint8_t *data, size_t *count);
	/* As struct usb_events has them, of other endpoints than 0. */
	void (*received)(void *context, unsigned endpoint, const uint8_t *bytes, size_t count);
	void (*ended)(void *context, unsigned endpoint);
	/* May the host end this endpoint's STALL? */
	bool (*cleared)(void *context, unsigned endpoint);
};

enum usb_stage {
	USB_IDLE,
	USB_DATA_IN,
	USB_DATA_OUT,
	USB_STATUS_IN,
	USB_STATUS_OUT,
};

struct usb_device {
	const struct usb_controller *controller;
	const struct usb_function *function;
	const struct usb_texts *texts;
	uint8_t address;
	bool configured;
	uint16_t stalled; /* endpoints, bit: number, and 8 more where to the host */
	uint8_t stage; /* enum usb_stage */
	bool empty; /* an empty packet ends the data, as they end with a full one */
	struct usb_setup setup;
	const uint8_t *at; /* data left to send */
	uint16_t left; /* bytes of it, or to come */
	uint16_t taken; /* bytes that came */
	uint8_t data[USB_CONTROL_BYTES];
};

/* All outlive the device. Returns what the controller calls. */
struct usb_events usb_device_init(struct usb_device *device, const struct usb_controller *controller,
				  const struct usb_function *function, const struct usb_texts *texts);

/* From the function: an endpoint answers STALL until the host clears it. */
void usb_device_stall(struct usb_device *device, unsigned endpoint);
