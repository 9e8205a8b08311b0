/* One DMA stream: set up once, started for each transfer. Direct mode, one memory buffer.
 * A stream's addresses are worked out once (stream_of), so that every function is a few register accesses. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"

/* Every buffer that DMA touches, so that no cache maintenance is ever due. What DMA writes and the control path reads
 * lies in DTCM (the linker script holds all of .bss there). What DMA reads never does: the vendor's errata for this
 * family say that DTCM answers no such read while the core sleeps. It lies, with the background's buffers, in memory
 * that core_start leaves uncached. */
#define DMA_BUFFER __attribute__((section(".bss.dma_buffers"), aligned(4)))
#define DMA_BUFFER_SLOW __attribute__((section(".uncached"), aligned(4)))

struct dma_stream {
	uint32_t at;       /* the registers of its own, as those of a controller's stream 0 are; 0: no stream */
	uint32_t flags;    /* likewise its flags: DMA_LISR(flags), DMA_LIFCR(flags) */
	uint8_t shift;     /* of its flags against stream 0's */
	uint8_t channel;   /* the request that drives it (RM0431 8.3.3, request mapping) */
	uint8_t interrupt; /* IRQ_... */
};

/* The stream that a board's description calls `code`. */
struct dma_stream stream_of(uint16_t code);

/* Values of DMA_SCR fields. */
enum dma_direction { DMA_FROM_PERIPHERAL = 0, DMA_TO_PERIPHERAL = 1 };
enum dma_width { DMA_BYTE = 0, DMA_HALF_WORD = 1, DMA_WORD = 2 };
enum dma_urgency { DMA_LOW = 0, DMA_MEDIUM = 1, DMA_HIGH = 2, DMA_VERY_HIGH = 3 };

#define DMA_DISABLE_LIMIT 2160u /* cycles, 10 us: a stream ends after the transfer on the bus */

/* All moved since dma_start. */
static inline bool dma_complete(struct dma_stream s)
{
	return (DMA_LISR(s.flags) >> s.shift & DMA_LISR_TCIF0) != 0u;
}

/* Which of `flags`, as those of stream 0, have come since they were taken last. */
static inline uint32_t dma_take_flags(struct dma_stream s, uint32_t flags)
{
	const uint32_t taken = DMA_LISR(s.flags) >> s.shift & flags;

	if (taken != 0u)
		DMA_LIFCR(s.flags) = taken << s.shift;
	return taken;
}
_Static_assert(DMA_LIFCR_CHTIF0 == DMA_LISR_HTIF0 && DMA_LIFCR_CTCIF0 == DMA_LISR_TCIF0, "cleared in their own places");

static inline void dma_clear(struct dma_stream s)
{
	DMA_LIFCR(s.flags) =
		(DMA_LIFCR_CFEIF0 | DMA_LIFCR_CDMEIF0 | DMA_LIFCR_CTEIF0 | DMA_LIFCR_CHTIF0 | DMA_LIFCR_CTCIF0)
		<< s.shift;
}

/* Is a transfer under way? The hardware ends it by itself when all is moved or an error stops it. */
static inline bool dma_busy(struct dma_stream s)
{
	return (DMA_SCR(s.at, 0) & DMA_SCR_EN) != 0u;
}

/* Ends a transfer early. False: the stream would not end, and must not be started. */
static inline bool dma_stop(struct dma_stream s)
{
	DMA_SCR(s.at, 0) &= ~DMA_SCR_EN;
	return time_wait(&DMA_SCR(s.at, 0), DMA_SCR_EN, 0, DMA_DISABLE_LIMIT);
}

/* `options`: further DMA_SCR bits (circular, interrupts). The stream must not be busy. */
static inline void dma_setup(struct dma_stream s, const volatile uint32_t *peripheral, enum dma_direction direction,
			     enum dma_width width, enum dma_urgency urgency, uint32_t options)
{
	DMA_SCR(s.at, 0) = FIELD(DMA_SCR_CHSEL, s.channel) | FIELD(DMA_SCR_PL, urgency) | FIELD(DMA_SCR_MSIZE, width) |
			   FIELD(DMA_SCR_PSIZE, width) | DMA_SCR_MINC | FIELD(DMA_SCR_DIR, direction) | options;
	DMA_SPAR(s.at, 0) = (uint32_t)peripheral;
}

/* `count` items from or to `buffer`. The stream must not be busy. */
static inline void dma_start(struct dma_stream s, const volatile void *buffer, uint32_t count)
{
	dma_clear(s);
	DMA_SM0AR(s.at, 0) = (uint32_t)buffer;
	DMA_SNDTR(s.at, 0) = count;
	barrier();
	DMA_SCR(s.at, 0) |= DMA_SCR_EN;
}

/* Items still to move. */
static inline uint32_t dma_remaining(struct dma_stream s)
{
	return DMA_SNDTR(s.at, 0) & DMA_SNDTR_NDT;
}
