/* Logs on the SD card of SPI3, by DMA and without an interrupt. Background only. */
#ifndef STM32F7_CARD_SPI_H
#define STM32F7_CARD_SPI_H

#include "port/log_device.h"

/* Pins and SPI are set up; looking for a card is left to the device's step. */
const struct log_device *card_spi_start(void);

#endif
