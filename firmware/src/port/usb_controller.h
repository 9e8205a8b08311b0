/* A USB device controller at full speed, and what it tells the device behind it. An endpoint is named by its address:
 * number, and USB_IN where it goes to the host (USB 2.0, 9.6.6). All from the background; nothing waits. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define USB_IN 0x80u
#define USB_PACKET_BYTES 64u /* of control and bulk endpoints: the most at full speed (USB 2.0, 5.5.3 and 5.8.3) */
#define USB_SETUP_BYTES 8u

enum usb_kind { USB_BULK = 2, USB_INTERRUPT = 3 }; /* of an endpoint: its bmAttributes */

struct usb_controller {
	void *context; /* the first argument of every function */
	/* From the status stage of the request under way on. */
	void (*address)(void *context, unsigned address);
	/* The endpoint is there from now on: it begins with DATA0, and sends or takes nothing yet. Not endpoint 0, which
	 * always is. */
	void (*open)(void *context, unsigned endpoint, enum usb_kind kind, size_t packet_bytes);
	/* All endpoints but 0 are gone. */
	void (*close)(void *context);
	/* Sends the first of `count` bytes, as many as the controller takes at once: of fewer than all a multiple of the
	 * packet's size. 0: an empty packet. Returns how many; `ended` follows. Only while nothing is being sent there. */
	size_t (*send)(void *context, unsigned endpoint, const uint8_t *bytes, size_t count);
	/* What is being sent there is forgotten; no `ended` follows. */
	void (*drop)(void *context, unsigned endpoint);
	/* Takes up to so many packets from the host, ended by a short one: `received` follows for each, then `ended`. An
	 * endpoint that still takes some goes on with those. Without it the host waits. */
	void (*receive)(void *context, unsigned endpoint, unsigned packets);
	/* Does it answer STALL? What ends it begins with DATA0. 0 does so in both directions, up to the next SETUP. */
	void (*stall)(void *context, unsigned endpoint, bool stalls);
};

struct usb_events {
	void *context;
	/* The bus was reset, or the cable is out: the device has no address, and no endpoint but 0. */
	void (*reset)(void *context);
	/* The host pauses; it is back with the next event of `reset`, or when `paused` is false. */
	void (*suspend)(void *context, bool paused);
	/* A request; nothing of one before it goes on. */
	void (*setup)(void *context, const uint8_t setup[USB_SETUP_BYTES]);
	void (*received)(void *context, unsigned endpoint, const uint8_t *bytes, size_t count);
	/* All was sent, or no more is received. */
	void (*ended)(void *context, unsigned endpoint);
};
