/* One DMA stream: set up once, started for each transfer. Direct mode, one memory buffer.
 * With constant arguments every function folds into a few register accesses. */
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
	uint32_t controller; /* DMA1 or DMA2 */
	uint32_t stream;     /* 0..7 */
	uint32_t channel;    /* the request that drives it (RM0431 8.3.3, request mapping) */
};

/* The stream that a board's description calls `code`; its controller is 0 where there is none. */
static inline struct dma_stream stream_of(uint16_t code)
{
	const uint32_t controller = code >> 8, channel = code & 0xFu;

	if (controller != 1u && controller != 2u)
		return (struct dma_stream){ 0, 0, 0 };
	return (struct dma_stream){ controller == 1u ? DMA1 : DMA2, code >> 4 & 7u, channel };
}

/* Streams of peripherals that every board uses (RM0431 8.3.3); board.h has the others. */
#define DMA_POWER ((struct dma_stream){ DMA2, 0, 0 })   /* ADC1 */
#define DMA_GYRO_RX ((struct dma_stream){ DMA2, 2, 3 }) /* SPI1_RX */
#define DMA_GYRO_TX ((struct dma_stream){ DMA2, 3, 3 }) /* SPI1_TX */

/* Values of DMA_SCR fields. */
enum dma_direction { DMA_FROM_PERIPHERAL = 0, DMA_TO_PERIPHERAL = 1 };
enum dma_width { DMA_BYTE = 0, DMA_HALF_WORD = 1, DMA_WORD = 2 };
enum dma_urgency { DMA_LOW = 0, DMA_MEDIUM = 1, DMA_HIGH = 2, DMA_VERY_HIGH = 3 };

#define DMA_DISABLE_LIMIT 2160u /* cycles, 10 us: a stream ends after the transfer on the bus */

/* The flags of streams 0..3 lie at bits 0, 6, 16 and 22 of LISR, those of 4..7 likewise in HISR (RM0431 8.5.1). */
static inline uint32_t dma_flag_shift(struct dma_stream s)
{
	return (s.stream % 4u) / 2u * 16u + s.stream % 2u * 6u;
}
_Static_assert(DMA_LISR_TCIF1 == DMA_LISR_TCIF0 << 6, "flags of stream 1");
_Static_assert(DMA_LISR_TCIF2 == DMA_LISR_TCIF0 << 16, "flags of stream 2");
_Static_assert(DMA_LISR_TCIF3 == DMA_LISR_TCIF0 << 22, "flags of stream 3");

/* All moved since dma_start. */
static inline bool dma_complete(struct dma_stream s)
{
	const uint32_t flags = s.stream < 4u ? DMA_LISR(s.controller) : DMA_HISR(s.controller);

	return (flags >> dma_flag_shift(s) & DMA_LISR_TCIF0) != 0u;
}

/* Which of `flags`, as those of stream 0, have come since they were taken last. */
static inline uint32_t dma_take_flags(struct dma_stream s, uint32_t flags)
{
	const uint32_t all = s.stream < 4u ? DMA_LISR(s.controller) : DMA_HISR(s.controller);
	const uint32_t taken = all >> dma_flag_shift(s) & flags;

	if (taken == 0u)
		return 0;
	if (s.stream < 4u)
		DMA_LIFCR(s.controller) = taken << dma_flag_shift(s);
	else
		DMA_HIFCR(s.controller) = taken << dma_flag_shift(s);
	return taken;
}
_Static_assert(DMA_LIFCR_CHTIF0 == DMA_LISR_HTIF0 && DMA_LIFCR_CTCIF0 == DMA_LISR_TCIF0, "cleared in their own places");

static inline void dma_clear(struct dma_stream s)
{
	const uint32_t all = DMA_LIFCR_CFEIF0 | DMA_LIFCR_CDMEIF0 | DMA_LIFCR_CTEIF0 | DMA_LIFCR_CHTIF0 |
			     DMA_LIFCR_CTCIF0;

	if (s.stream < 4u)
		DMA_LIFCR(s.controller) = all << dma_flag_shift(s);
	else
		DMA_HIFCR(s.controller) = all << dma_flag_shift(s);
}

/* Is a transfer under way? The hardware ends it by itself when all is moved or an error stops it. */
static inline bool dma_busy(struct dma_stream s)
{
	return (DMA_SCR(s.controller, s.stream) & DMA_SCR_EN) != 0u;
}

/* Ends a transfer early. False: the stream would not end, and must not be started. */
static inline bool dma_stop(struct dma_stream s)
{
	DMA_SCR(s.controller, s.stream) &= ~DMA_SCR_EN;
	return time_wait(&DMA_SCR(s.controller, s.stream), DMA_SCR_EN, 0, DMA_DISABLE_LIMIT);
}

/* `options`: further DMA_SCR bits (circular, interrupts). The stream must not be busy. */
static inline void dma_setup(struct dma_stream s, const volatile uint32_t *peripheral, enum dma_direction direction,
			     enum dma_width width, enum dma_urgency urgency, uint32_t options)
{
	DMA_SCR(s.controller, s.stream) = FIELD(DMA_SCR_CHSEL, s.channel) | FIELD(DMA_SCR_PL, urgency) |
					  FIELD(DMA_SCR_MSIZE, width) | FIELD(DMA_SCR_PSIZE, width) | DMA_SCR_MINC |
					  FIELD(DMA_SCR_DIR, direction) | options;
	DMA_SPAR(s.controller, s.stream) = (uint32_t)peripheral;
}

/* `count` items from or to `buffer`. The stream must not be busy. */
static inline void dma_start(struct dma_stream s, const volatile void *buffer, uint32_t count)
{
	dma_clear(s);
	DMA_SM0AR(s.controller, s.stream) = (uint32_t)buffer;
	DMA_SNDTR(s.controller, s.stream) = count;
	barrier();
	DMA_SCR(s.controller, s.stream) |= DMA_SCR_EN;
}

/* Items still to move. */
static inline uint32_t dma_remaining(struct dma_stream s)
{
	return DMA_SNDTR(s.controller, s.stream) & DMA_SNDTR_NDT;
}
