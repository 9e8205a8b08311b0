/* A disk of a USB device that can only be read: mass storage by bulk transfers alone (USB Mass Storage Class, Bulk-Only
 * Transport 1.0) with the commands that Linux, macOS and Windows send (SCSI SPC-2 and SBC). */
#pragma once

#include "usb/usb_device.h"

#define USB_DISK_PRODUCT 0x5720u /* STMicroelectronics' number for such disks */
#define USB_DISK_BLOCK_BYTES 512u
#define USB_DISK_REPLY_BYTES 36u /* of a command's data, but for blocks */
#define USB_DISK_COMMAND_BYTES 31u
#define USB_DISK_STATUS_BYTES 13u

enum usb_medium_answer { USB_MEDIUM_DONE, USB_MEDIUM_LATER, USB_MEDIUM_FAILED };

/* What the disk reads from. */
struct usb_medium {
	void *context;
	/* How many blocks there are; 0: there is no medium now. */
	uint32_t (*blocks)(void *context);
	/* Reads a block, which there is. LATER: asked again for the same one. */
	enum usb_medium_answer (*read)(void *context, uint32_t block, uint8_t bytes[USB_DISK_BLOCK_BYTES]);
};

enum usb_disk_stage {
	USB_DISK_COMMAND, /* the next one is waited for */
	USB_DISK_REPLY, /* data of a command */
	USB_DISK_BLOCKS, /* blocks that it asked for */
	USB_DISK_STATUS, /* its status is to be sent, once the data's endpoint is free */
	USB_DISK_ENDING, /* the status is on its way */
	USB_DISK_LOST, /* what came was no command: only the host's reset helps (Bulk-Only Transport, 6.6.1) */
};

struct usb_disk {
	struct usb_device *device;
	const struct usb_controller *controller;
	const struct usb_medium *medium;
	bool configured;
	bool ejected; /* read: by the host */
	bool seen; /* the host has been told of this medium */
	bool hears, sends;
	bool stalls; /* the data's endpoint, until the host ends it */
	bool told_end; /* the host knows that no more data of this command follow */
	uint8_t stage; /* enum usb_disk_stage */
	uint8_t status; /* of the command */
	uint8_t sense, reason; /* why the last one failed: sense key, additional sense code */
	uint32_t tag;
	uint32_t expected; /* bytes that the host still waits for */
	uint32_t block, blocks; /* the next one, and how many are left */
	uint16_t filled, sent; /* of `bytes` */
	uint8_t bytes[USB_DISK_BLOCK_BYTES];
};

/* Fills in `function`, which `device` is then initialised with. All outlive the disk. */
void usb_disk_init(struct usb_disk *disk, struct usb_device *device, const struct usb_controller *controller,
		   const struct usb_medium *medium, struct usb_function *function);

/* Goes on with a command; again and again. */
void usb_disk_step(struct usb_disk *disk);
