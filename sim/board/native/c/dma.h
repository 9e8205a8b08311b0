/* DMA1 and DMA2. What drivers call of it is in api.h. */
#ifndef NATIVE_DMA_H
#define NATIVE_DMA_H

#include "native.h"

void dma_reset(struct native *n, uint32_t controller);
void dma_sleep(struct native *n); /* the core sleeps: fails if a stream reads DTCM, which does not answer then */
uint32_t dma_read(struct native *n, uint32_t device, uint32_t word);
void dma_write(struct native *n, uint32_t device, uint32_t word, uint32_t value);

#endif
