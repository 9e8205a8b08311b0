/* A serial port of a USB device: CDC-ACM, which Linux, macOS and Windows from 10 on have a driver for. (USB Class
 * Definitions for Communications Devices 1.2, and its PSTN subclass 1.2.)
 *
 * Its rate means nothing: bytes go as fast as the bus and both ends take them, and none is lost. */
#pragma once

#include "port/serial_line.h"
#include "usb/usb_device.h"

#define USB_SERIAL_PRODUCT 0x5740u /* STMicroelectronics' number for such ports */
#define USB_SERIAL_RING_BYTES 1024u
#define USB_SERIAL_SEND_BYTES 1024u
#define USB_SERIAL_CODING_BYTES 7u

struct usb_serial {
	const struct usb_controller *controller;
	bool configured, paused;
	bool asked;   /* data terminal ready: a program has the port open */
	bool changed; /* the peer has gone, or another is there, since the last look */
	bool hears;   /* the host may send */
	bool sends;   /* something is on its way to the host */
	bool full;    /* what was sent last ended with a full packet: the host waits for more */
	uint8_t coding[USB_SERIAL_CODING_BYTES]; /* as the host has set it */
	uint32_t head, tail; /* bytes that came, and that were read */
	uint32_t looked;     /* what `head` was at the last look */
	uint32_t filled, sent; /* of `words` */
	uint8_t ring[USB_SERIAL_RING_BYTES];
	uint8_t words[USB_SERIAL_SEND_BYTES];
};

/* Fills in `function`, which a device is then initialised with. All outlive the port. */
void usb_serial_init(struct usb_serial *serial, const struct usb_controller *controller, struct usb_function *function);

/* The port as a line. A peer has gone when the host drops DTR, pauses, resets the bus or is unplugged; what it would have
 * read is forgotten. */
struct serial_line usb_serial_line(struct usb_serial *serial);
