#include "hal/stm32f7/devices/devices.h"

#include "msp/msp.h"
#include "usb/usb_serial.h"

_Static_assert(USB_SERIAL_SEND_BYTES >= 2 * MSP_FRAME_MAX, "room for a reply, and for what is said unasked");

/* The background's alone. */
static struct usb_serial usb_serial;
static struct usb_function usb_line_function;

bool usb_line_open(const char *product, struct serial_line *line)
{
	const struct usb_controller *const controller = usb_bus_start();

	if (controller == NULL)
		return false;
	usb_serial_init(&usb_serial, controller, &usb_line_function);
	usb_bus_serve(&usb_line_function, product);
	*line = usb_serial_line(&usb_serial);
	return true;
}
