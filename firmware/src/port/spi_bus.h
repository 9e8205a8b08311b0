/* An SPI bus with one chip that keeps logs, given by the HAL. Nothing waits: a transfer is started, and asked for its end. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define SPI_BUS_BYTES \
	520u /* a card's block on the line and the answer to it, or 512 bytes of a flash chip behind a command */

struct spi_bus {
	void *context; /* the first argument of every function */
	uint8_t *bytes; /* [SPI_BUS_BYTES]: what is sent, and after a transfer what came */
	/* Exchanges the first `count` of `bytes`. One that fails leaves them or garbage. */
	void (*start)(void *context, size_t count);
	/* Has the transfer ended? */
	bool (*done)(void *context);
	void (*select)(void *context, bool selected); /* only between transfers */
	void (*speed)(void *context, bool fast); /* at most 400 kHz, or 25 MHz; likewise */
	uint32_t (*milliseconds)(void *context); /* any clock, wraps at 2^32 */
};
