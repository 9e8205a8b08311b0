/* SPI1 and SPI3 as masters; `i`: their place, 0 or 1. */
#ifndef NATIVE_SPI_H
#define NATIVE_SPI_H

#include "native.h"

enum { SPI_DR = 3 }; /* word */

extern const struct driver spi_driver;

void spi_reset(struct native *n, uint32_t i);
void spi_sync(struct native *n, uint32_t i);
void spi_start(struct native *n, uint32_t i);
void spi_plan(struct native *n, uint32_t i);
uint32_t spi_read(struct native *n, uint32_t i, uint32_t word, uint32_t size);
void spi_write(struct native *n, uint32_t i, uint32_t word, uint32_t size, uint32_t value);

#endif
