#include "hal/stm32f7/peripherals/dma.h"

#define CONTROLLERS 2u
#define STREAMS 8u
#define STREAM_STEP ((uint32_t)&DMA_SCR(0, 1) - (uint32_t)&DMA_SCR(0, 0))
#define HALF_STEP ((uint32_t)&DMA_HISR(0) - (uint32_t)&DMA_LISR(0))

static const struct {
	uint32_t at;
	uint8_t interrupts[STREAMS];
} controllers[CONTROLLERS] = {
	{ DMA1,
	  { IRQ_DMA1_STREAM0, IRQ_DMA1_STREAM1, IRQ_DMA1_STREAM2, IRQ_DMA1_STREAM3, IRQ_DMA1_STREAM4, IRQ_DMA1_STREAM5,
	    IRQ_DMA1_STREAM6, IRQ_DMA1_STREAM7 } },
	{ DMA2,
	  { IRQ_DMA2_STREAM0, IRQ_DMA2_STREAM1, IRQ_DMA2_STREAM2, IRQ_DMA2_STREAM3, IRQ_DMA2_STREAM4, IRQ_DMA2_STREAM5,
	    IRQ_DMA2_STREAM6, IRQ_DMA2_STREAM7 } },
};

/* The flags of streams 0..3 lie at bits 0, 6, 16 and 22 of LISR, those of 4..7 likewise in HISR (RM0431 8.5.1). */
static uint8_t dma_flag_shift(uint32_t stream)
{
	return (uint8_t)(stream % 4u / 2u * 16u + stream % 2u * 6u);
}
_Static_assert(DMA_LISR_TCIF1 == DMA_LISR_TCIF0 << 6, "flags of stream 1");
_Static_assert(DMA_LISR_TCIF2 == DMA_LISR_TCIF0 << 16, "flags of stream 2");
_Static_assert(DMA_LISR_TCIF3 == DMA_LISR_TCIF0 << 22, "flags of stream 3");

struct dma_stream stream_of(uint16_t code)
{
	const uint32_t controller = (code >> 8) - 1u, stream = code >> 4 & 0xFu;

	if (controller >= CONTROLLERS || stream >= STREAMS)
		return (struct dma_stream){ 0 };
	return (struct dma_stream){
		.at = controllers[controller].at + STREAM_STEP * stream,
		.flags = controllers[controller].at + HALF_STEP * (stream / 4u),
		.shift = dma_flag_shift(stream),
		.channel = code & 0xFu,
		.interrupt = controllers[controller].interrupts[stream],
	};
}
