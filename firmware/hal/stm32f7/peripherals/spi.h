/* SPI1 as master, 8 bits, mode 3 (clock rests high, data taken on the rising edge). */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Divider of APB2's 108 MHz: 2 << value (SPI_CR1 BR). */
enum spi_speed {
	SPI_13M5 = 2,  /* 13.5 MHz */
	SPI_6M75 = 3,  /* 6.75 MHz */
	SPI_844K = 6,  /* 0.84 MHz */
};

/* Off, at `speed`. Only while no transfer is under way. */
void spi_configure(enum spi_speed speed);

/* Exchanges `count` bytes in place, waiting for each. False: the bus did not respond in time. */
bool spi_exchange(uint8_t *bytes, size_t count);

/* Starts exchanging `count` bytes by DMA; DMA_GYRO_RX's complete interrupt says when. False: the streams
 * are not free. */
bool spi_start(const volatile uint8_t *send, volatile uint8_t *receive, uint32_t count);

/* Ends what spi_start began, complete or not. False: the bus or a stream is stuck. */
bool spi_finish(void);

/* Sets DMA up for spi_start. */
void spi_dma_setup(void);
