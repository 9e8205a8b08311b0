/* The SPI of the gyro chip as master, 8 bits, mode 3 (clock rests high, data taken on the rising edge). */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hal/stm32f7/peripherals/dma.h"

/* Divider of APB2's 108 MHz: 2 << value (SPI_CR1 BR); on APB1, of half that clock, one less makes the same. */
enum spi_speed {
	SPI_13M5 = 2,  /* 13.5 MHz */
	SPI_6M75 = 3,  /* 6.75 MHz */
	SPI_844K = 6,  /* 0.84 MHz */
};

/* The registers of SPI `number`, 1 to 3; 0: there is none. */
uint32_t spi_at(uint32_t number);

/* Takes SPI `number` and its pins from the board's description, off. False: the board does not have it. */
bool spi_open(uint32_t number);

/* Off, at `speed`. Only while no transfer is under way. */
void spi_configure(enum spi_speed speed);

/* Exchanges `count` bytes in place, waiting for each. False: the bus did not respond in time. */
bool spi_exchange(uint8_t *bytes, size_t count);

/* Starts exchanging `count` bytes by DMA; the interrupt of what spi_dma_setup returned says when it is complete. False: the
 * streams are not free. */
bool spi_start(const volatile uint8_t *send, volatile uint8_t *receive, uint32_t count);

/* Ends what spi_start began, complete or not. False: the bus or a stream is stuck. */
bool spi_finish(void);

/* Sets DMA up for spi_start. Returns the stream that receives. */
struct dma_stream spi_dma_setup(void);
