#include "hal/stm32f7/core/board.h"

#define PIN_OF(port, number) ((uint8_t)(((port) - 'A') << 4 | (number)))
#define DMA_OF(controller, stream, channel) ((uint16_t)((controller) << 8 | (stream) << 4 | (channel)))

/* MATEKF722's, until toolchain.image.stamp writes what the build asks for. */
__attribute__((section(".board"), used)) const struct board board = {
	.magic = NF_BOARD_MAGIC,
	.layout = NF_BOARD_LAYOUT,
	.bytes = sizeof(struct board),
	.name = "MATEKF722",
	.maker = "MTKS",
	.gyro_kinds = 1u << 0 | 1u << 2, /* MPU-6500, ICM-20602; of an ICM-20689 sources say 90 and 180 degrees */
	.gyros = { { .spi = 1, .select = PIN_OF('C', 2), .ready = PIN_OF('C', 3), .alignment = 2 },
		   { .select = NF_BOARD_NO_PIN, .ready = NF_BOARD_NO_PIN } },
	.log_chip = { .spi = 3, .select = PIN_OF('C', 1), .ready = NF_BOARD_NO_PIN },
	.osd = { .spi = 2, .select = PIN_OF('B', 10), .ready = NF_BOARD_NO_PIN },
	.buses = { { .sck = PIN_OF('A', 5),
		     .sck_function = 5,
		     .miso = PIN_OF('A', 6),
		     .miso_function = 5,
		     .mosi = PIN_OF('A', 7),
		     .mosi_function = 5,
		     .dma_rx = DMA_OF(2, 2, 3),
		     .dma_tx = DMA_OF(2, 3, 3) },
		   { .sck = PIN_OF('B', 13),
		     .sck_function = 5,
		     .miso = PIN_OF('B', 14),
		     .miso_function = 5,
		     .mosi = PIN_OF('B', 15),
		     .mosi_function = 5 },
		   { .sck = PIN_OF('B', 3),
		     .sck_function = 6,
		     .miso = PIN_OF('B', 4),
		     .miso_function = 6,
		     .mosi = PIN_OF('B', 5),
		     .mosi_function = 6,
		     .dma_rx = DMA_OF(1, 0, 0),
		     .dma_tx = DMA_OF(1, 7, 0) } },
	.msp = { .number = 1,
		 .tx = PIN_OF('A', 9),
		 .tx_function = 7,
		 .rx = PIN_OF('A', 10),
		 .rx_function = 7,
		 .dma_rx = DMA_OF(2, 5, 4),
		 .dma_tx = DMA_OF(2, 7, 4) },
	.second = { .number = 3,
		    .tx = PIN_OF('C', 10),
		    .tx_function = 7,
		    .rx = PIN_OF('C', 11),
		    .rx_function = 7,
		    .dma_rx = DMA_OF(1, 1, 4),
		    .dma_tx = DMA_OF(1, 3, 4) },
	.receiver = { .number = 2,
		      .tx = NF_BOARD_NO_PIN,
		      .rx = PIN_OF('A', 3),
		      .rx_function = 7,
		      .dma_rx = DMA_OF(1, 5, 4) },
	.motor_ports = { { .port = 2, .channel = 3, .dma = DMA_OF(2, 6, 6) },
			 { .port = 1, .channel = 4, .dma = DMA_OF(2, 4, 6) },
			 { .port = 0, .channel = 1, .dma = DMA_OF(2, 1, 6) } },
	.motor_pins = { PIN_OF('C', 6), PIN_OF('C', 7), PIN_OF('C', 8), PIN_OF('C', 9), PIN_OF('B', 1), PIN_OF('A', 8),
			NF_BOARD_NO_PIN, NF_BOARD_NO_PIN },
	.motor_count = 6,
	.motor_port_count = 3,
	.log_kind = 1, /* card */
	.led = PIN_OF('B', 9),
	.led_high = 0, /* low lights it; LED1 (PA14) is left to the debugger's SWCLK */
	.beeper = PIN_OF('C', 13),
	.beeper_high = 1, /* high sounds, what the ecosystem calls inverted */
	.usb_supply = PIN_OF('B', 12),
	.volts = PIN_OF('C', 0),
	.amps = PIN_OF('C', 4),
	.adc_dma = DMA_OF(2, 0, 0),
	.volts_scale = 110,
	.amps_scale = 179,
};

bool board_is_known(const struct board *described)
{
	return described->magic == NF_BOARD_MAGIC && described->layout == NF_BOARD_LAYOUT &&
	       described->bytes == sizeof(struct board);
}
