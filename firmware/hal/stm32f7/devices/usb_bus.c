#include "hal/stm32f7/devices/devices.h"

#include "common/printer.h"
#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/peripherals/otg.h"
#include "nf_contract.h"

#define SETTLED_MS 20u /* the cable's supply bounces for so long when it is plugged in; pulled, it counts at once */
#define UNPLUGGED_MS 20u
#define UNSEEN_MS 3000u /* in which a host finds what it is shown, and after which one that pauses does not come back */
#define AWAKE_MS 1u /* behind something that happened more may follow at once */
#define SERIAL_DIGITS 12
#define USB_FUNCTION 10u /* alternate function of the pins below (data sheet), which are the chip's */
#define USB_DM ((struct pin){ GPIOA, 11 })
#define USB_DP ((struct pin){ GPIOA, 12 })
#define SERIAL_BYTES (SERIAL_DIGITS + 2u) /* with what a printer keeps free */

/* The background's alone. */
static struct {
	const struct usb_controller *controller;
	struct usb_device device;
	struct usb_events events;
	struct usb_texts texts;
	char serial[SERIAL_BYTES + 1u];
	bool served;
	bool connected;
	bool heard; /* a host has been there */
	uint32_t unpowered_ms; /* when the supply was found missing last */
	uint32_t busy_ms; /* when something happened last */
} bus;

/* A loose pin reads low. Most boards do not have it: there the cable counts as plugged in, and one that is pulled out looks like
 * a host that pauses. */
static bool usb_bus_powered(void)
{
	return gpio_read(pin_of(board.usb_supply), true);
}

uint32_t usb_bus_patience_ms(void)
{
	return pin_of(board.usb_supply).port != 0u ? UNPLUGGED_MS : UNSEEN_MS;
}

bool usb_bus_seen(void)
{
	return pin_of(board.usb_supply).port != 0u ? usb_bus_powered() : bus.heard && otg_awake();
}

/* The number by which the chip's boot loader, and other firmware, names the board: ST's examples make it of the unique id so
 * (from memory: (word 0 + word 2) and the upper half of word 1, in hexadecimal digits). */
static void usb_bus_number(void)
{
	struct printer p = printer_init(bus.serial, SERIAL_BYTES);
	const uint32_t number = SIGNATURE_UID(0) + SIGNATURE_UID(2);
	const uint32_t words[] = { number, SIGNATURE_UID(1) >> 16 };

	for (unsigned digit = 0; digit < SERIAL_DIGITS; ++digit) {
		const uint32_t nibble = words[digit / 8u] >> (digit < 8u ? 28u - 4u * digit : 12u - 4u * (digit - 8u)) &
					0xFu;
		printer_say(&p, "%c", (char)(nibble < 10u ? '0' + nibble : 'A' + nibble - 10u));
	}
	*p.at = '\0';
}

const struct usb_controller *usb_bus_start(void)
{
	RCC_AHB2ENR |= RCC_AHB2ENR_OTGFSEN;
	(void)RCC_AHB2ENR;
	gpio_input(pin_of(board.usb_supply), GPIO_PULL_DOWN);
	gpio_alternate(USB_DM, USB_FUNCTION, GPIO_FLOATING, GPIO_FAST);
	gpio_alternate(USB_DP, USB_FUNCTION, GPIO_FLOATING, GPIO_FAST);
	bus.controller = otg_start();
	bus.unpowered_ms = time_ms();
	return bus.controller;
}

struct usb_device *usb_bus_device(void)
{
	return &bus.device;
}

void usb_bus_serve(const struct usb_function *function, const char *product)
{
	usb_bus_number();
	bus.texts = (struct usb_texts){ NF_MSP_FIRMWARE, product, bus.serial };
	bus.events = usb_device_init(&bus.device, bus.controller, function, &bus.texts);
	bus.served = true;
}

/* A device without its supply is off the bus: it must not hold a line up (USB 2.0, 7.1.5). */
static void usb_bus_watch(uint32_t now)
{
	const bool powered = usb_bus_powered();

	if (!powered)
		bus.unpowered_ms = now;
	if (powered == bus.connected || (powered && now - bus.unpowered_ms <= SETTLED_MS) || !otg_connect(powered))
		return;
	bus.connected = powered;
	if (!powered)
		bus.events.reset(bus.events.context);
}

bool usb_bus_step(void)
{
	const uint32_t now = time_ms();

	if (!bus.served)
		return false;
	usb_bus_watch(now);
	if (bus.connected && otg_poll(&bus.events)) {
		bus.busy_ms = now;
		bus.heard = true;
	}
	return bus.connected && now - bus.busy_ms <= AWAKE_MS;
}
