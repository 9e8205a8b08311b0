#include "hal/stm32f7/devices/devices.h"

#include "board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/peripherals/dma.h"
#include "storage/card/card_log.h"

enum { BITS_8 = 7 }; /* SPI_CR2 DS */
/* SPI_CR1 BR: APB1's 54 MHz divided by 2 << value. A card takes 400 kHz until it is initialised, then 25 MHz. */
enum { SPEED_211K = 7, SPEED_13M5 = 1 };
#define TRANSFER_MS 50u /* the longest takes 20 */

/* Bytes to send; DMA overwrites them with the received bytes, at least one byte behind. */
static DMA_BUFFER_SLOW uint8_t card_bytes[SPI_BUS_BYTES];
static struct card_log card_log;
static struct log_device device;
static uint32_t started_ms;

/* The order is the manual's (RM0431 SPI, communication using DMA). */
static void card_start(void *context, size_t count)
{
	started_ms = time_ms();
	SPI_CR2(BOARD_CARD_SPI) |= SPI_CR2_RXDMAEN;
	dma_start(BOARD_CARD_DMA_RX, card_bytes, (uint32_t)count);
	dma_start(BOARD_CARD_DMA_TX, card_bytes, (uint32_t)count);
	SPI_CR2(BOARD_CARD_SPI) |= SPI_CR2_TXDMAEN;
	SPI_CR1(BOARD_CARD_SPI) |= SPI_CR1_SPE;
}

/* The SPI is off between transfers. One that an error of the bus has stopped ends by time. */
static bool card_done(void *context)
{
	if ((dma_busy(BOARD_CARD_DMA_RX) || (SPI_SR(BOARD_CARD_SPI) & SPI_SR_BSY) != 0u) &&
	    time_ms() - started_ms <= TRANSFER_MS)
		return false;
	(void)dma_stop(BOARD_CARD_DMA_TX); /* where one does not stop, what it moves later has checksums */
	(void)dma_stop(BOARD_CARD_DMA_RX);
	SPI_CR1(BOARD_CARD_SPI) &= ~SPI_CR1_SPE;
	SPI_CR2(BOARD_CARD_SPI) &= ~(SPI_CR2_RXDMAEN | SPI_CR2_TXDMAEN);
	barrier();
	return true;
}

static void card_select(void *context, bool selected)
{
	gpio_write(BOARD_CARD_CS, !selected);
}

static void card_speed(void *context, bool fast)
{
	SPI_CR1(BOARD_CARD_SPI) = SPI_CR1_MSTR | SPI_CR1_SSM | SPI_CR1_SSI |
				  FIELD(SPI_CR1_BR, fast ? SPEED_13M5 : SPEED_211K);
}

static uint32_t card_milliseconds(void *context)
{
	return time_ms();
}

static const struct spi_bus bus = {
	.bytes = card_bytes,
	.start = card_start,
	.done = card_done,
	.select = card_select,
	.speed = card_speed,
	.milliseconds = card_milliseconds,
};

const struct spi_bus *card_spi_open(void)
{
	gpio_output(BOARD_CARD_CS, true);
	/* The pull-up makes an empty slot say nothing but ones. */
	gpio_alternate(BOARD_CARD_SCK, BOARD_CARD_AF, GPIO_PULL_DOWN, GPIO_MEDIUM);
	gpio_alternate(BOARD_CARD_MISO, BOARD_CARD_AF, GPIO_PULL_UP, GPIO_MEDIUM);
	gpio_alternate(BOARD_CARD_MOSI, BOARD_CARD_AF, GPIO_PULL_UP, GPIO_MEDIUM);
	card_speed(NULL, false);
	SPI_CR2(BOARD_CARD_SPI) = FIELD(SPI_CR2_DS, BITS_8) | SPI_CR2_FRXTH;
	dma_setup(BOARD_CARD_DMA_RX, &SPI_DR(BOARD_CARD_SPI), DMA_FROM_PERIPHERAL, DMA_BYTE, DMA_MEDIUM, 0);
	dma_setup(BOARD_CARD_DMA_TX, &SPI_DR(BOARD_CARD_SPI), DMA_TO_PERIPHERAL, DMA_BYTE, DMA_LOW, 0);
	return &bus;
}

const struct log_device *card_spi_start(void)
{
	card_log_init(&card_log, card_spi_open(), &device);
	return &device;
}
