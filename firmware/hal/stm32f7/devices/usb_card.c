#include "hal/stm32f7/devices/devices.h"

#include <string.h>

#include "common/printer.h"
#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/led.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/core/watchdog.h"
#include "storage/card/sd_card.h"
#include "usb/usb_disk.h"

#define EJECTED_MS 1000u /* the host takes its leave */
#define BLINK_MS 512u

_Static_assert(SD_BLOCK_BYTES == USB_DISK_BLOCK_BYTES, "a block is one");

/* This mode's alone. */
static struct sd_card usb_card;
static struct usb_disk usb_disk;
static struct usb_function usb_disk_function;
static uint32_t usb_card_asked = SD_NO_BLOCK; /* block that is being read for the host */

static uint32_t usb_card_blocks(void *context)
{
	return usb_card.blocks;
}

/* While a block is on its way to the host the card reads the next one, which it most likely wants. */
static enum usb_medium_answer usb_card_read(void *context, uint32_t block, uint8_t bytes[USB_DISK_BLOCK_BYTES])
{
	if (usb_card.blocks == 0u)
		return USB_MEDIUM_FAILED;
	if (!sd_card_free(&usb_card))
		return USB_MEDIUM_LATER;
	if (usb_card.held == block) {
		usb_card_asked = SD_NO_BLOCK;
		memcpy(bytes, usb_card.data, USB_DISK_BLOCK_BYTES);
		if (block + 1u < usb_card.blocks)
			sd_card_read_on(&usb_card, block + 1u);
		return USB_MEDIUM_DONE;
	}
	const bool failed = usb_card_asked == block; /* told once; the host may try again */

	usb_card_asked = failed ? SD_NO_BLOCK : block;
	if (failed)
		return USB_MEDIUM_FAILED;
	sd_card_read_on(&usb_card, block);
	return USB_MEDIUM_LATER;
}

static const struct usb_medium medium = { .blocks = usb_card_blocks, .read = usb_card_read };

/* Does the host, or the pilot, want it no more? */
static bool usb_card_over(uint32_t *plugged_ms, uint32_t *wanted_ms)
{
	const uint32_t now = time_ms();

	if (usb_bus_seen())
		*plugged_ms = now;
	if (!usb_disk.ejected)
		*wanted_ms = now;
	return now - *plugged_ms > usb_bus_patience_ms() || now - *wanted_ms > EJECTED_MS;
}

void usb_card_run(void)
{
	const struct usb_controller *const controller = usb_bus_start();
	const struct spi_bus *const card = log_spi_open();
	char product[sizeof board.name + sizeof " SD card"];
	uint32_t plugged_ms = time_ms(), wanted_ms = plugged_ms;

	if (controller == NULL || card == NULL)
		return;
	sd_card_init(&usb_card, card);
	usb_disk_init(&usb_disk, usb_bus_device(), controller, &medium, &usb_disk_function);
	struct printer p = printer_init(product, sizeof product - 1u);
	printer_say(&p, "%s SD card", board.name);
	*p.at = '\0';
	usb_bus_serve(&usb_disk_function, product);
	while (!usb_card_over(&plugged_ms, &wanted_ms)) {
		const bool busy = usb_bus_step();

		sd_card_step(&usb_card);
		usb_disk_step(&usb_disk);
		watchdog_feed();
		led_light((time_ms() & BLINK_MS) == 0u);
		if (!busy && usb_disk.stage == USB_DISK_COMMAND)
			wait_for_interrupt();
	}
}
