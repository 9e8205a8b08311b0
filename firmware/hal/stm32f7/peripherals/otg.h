/* The chip's USB controller at full speed, as a device: endpoints 0 to 2, its FIFOs filled and emptied by the processor.
 * Polled, without an interrupt or DMA of its own, so that it costs the control path nothing. Background only.
 *
 * Source: RM0431, chapter OTG_FS/OTG_HS. */
#pragma once

#include <stdbool.h>

#include "port/usb_controller.h"

/* Off the bus, ready for otg_connect. Its clocks and pins are set up. Returns the controller; NULL: it did not answer. */
const struct usb_controller *otg_start(void);

/* Shows the host a device, or no longer. False: it cannot yet; ask again. */
bool otg_connect(bool connected);

/* Is there traffic on the bus, as a host makes every millisecond? Not since 3 ms where the cable is out. */
bool otg_awake(void);

/* Passes on what has happened since the last call, at most so much as the FIFOs hold. Returns whether anything has. */
bool otg_poll(const struct usb_events *events);
