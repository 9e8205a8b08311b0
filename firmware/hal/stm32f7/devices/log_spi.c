#include "hal/stm32f7/devices/devices.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/peripherals/dma.h"
#include "hal/stm32f7/peripherals/spi.h"
#include "storage/card/card_log.h"
#include "storage/flash_chip/flash_log.h"

enum { BITS_8 = 7 }; /* SPI_CR2 DS */
/* SPI_CR1 BR: APB1's 54 MHz divided by 2 << value, for SPI1 APB2's 108 MHz by one step more. A card takes 400 kHz until it
 * is initialised, then 25 MHz; SPI1's slowest is 422 kHz. */
enum { SPEED_211K = 7, SPEED_13M5 = 1, SLOWEST = 7 };
#define TRANSFER_MS 50u /* the longest takes 20 */

/* Bytes to send; DMA overwrites them with the received bytes, at least one byte behind. */
static DMA_BUFFER_SLOW uint8_t spi_bytes[SPI_BUS_BYTES];
/* A board has one of them. */
static union {
	struct card_log card;
	struct flash_log flash;
} log_spi;
_Static_assert(sizeof(struct flash_log) <= sizeof(struct card_log), "a flash chip needs no more memory");
static struct log_device device;
static uint32_t started_ms;

/* Of the board's description; set by log_spi_open. */
static uint32_t spi;
static struct dma_stream rx, tx;
static struct pin select;

/* The order is the manual's (RM0431 SPI, communication using DMA). */
static void log_spi_move(void *context, size_t count)
{
	started_ms = time_ms();
	SPI_CR2(spi) |= SPI_CR2_RXDMAEN;
	dma_start(rx, spi_bytes, (uint32_t)count);
	dma_start(tx, spi_bytes, (uint32_t)count);
	SPI_CR2(spi) |= SPI_CR2_TXDMAEN;
	SPI_CR1(spi) |= SPI_CR1_SPE;
}

/* The SPI is off between transfers. One that an error of the bus has stopped ends by time. */
static bool log_spi_moved(void *context)
{
	if ((dma_busy(rx) || (SPI_SR(spi) & SPI_SR_BSY) != 0u) && time_ms() - started_ms <= TRANSFER_MS)
		return false;
	(void)dma_stop(tx); /* where one does not stop, what it moves later has checksums */
	(void)dma_stop(rx);
	SPI_CR1(spi) &= ~SPI_CR1_SPE;
	SPI_CR2(spi) &= ~(SPI_CR2_RXDMAEN | SPI_CR2_TXDMAEN);
	barrier();
	return true;
}

static void log_spi_select(void *context, bool selected)
{
	gpio_write(select, !selected);
}

static void log_spi_speed(void *context, bool fast)
{
	const uint32_t divider = (fast ? SPEED_13M5 : SPEED_211K) + (spi == SPI1 ? 1u : 0u);

	SPI_CR1(spi) = SPI_CR1_MSTR | SPI_CR1_SSM | SPI_CR1_SSI |
		       FIELD(SPI_CR1_BR, divider < SLOWEST ? divider : SLOWEST);
}

static uint32_t log_spi_milliseconds(void *context)
{
	return time_ms();
}

static const struct spi_bus bus = {
	.bytes = spi_bytes,
	.start = log_spi_move,
	.done = log_spi_moved,
	.select = log_spi_select,
	.speed = log_spi_speed,
	.milliseconds = log_spi_milliseconds,
};

/* Has the board a place for a chip, on an SPI of its own? */
static bool log_spi_there(void)
{
	return board.log_kind != BOARD_LOG_NONE && spi_at(board.log_chip.spi) != 0u &&
	       board.log_chip.spi != board.gyros[0].spi;
}

bool log_spi_has_card(void)
{
	return board.log_kind == BOARD_LOG_CARD && log_spi_there();
}

const struct spi_bus *log_spi_open(void)
{
	if (!log_spi_there())
		return NULL;
	const struct board_bus *const told = &board.buses[board.log_chip.spi - 1u];

	spi = spi_at(board.log_chip.spi);
	rx = stream_of(told->dma_rx);
	tx = stream_of(told->dma_tx);
	select = pin_of(board.log_chip.select);
	if (rx.at == 0u || tx.at == 0u || select.port == 0u)
		return NULL;
	gpio_output(select, true);
	/* The pull-up makes an empty slot, or place, say nothing but ones. */
	gpio_alternate(pin_of(told->sck), told->sck_function, GPIO_PULL_DOWN, GPIO_MEDIUM);
	gpio_alternate(pin_of(told->miso), told->miso_function, GPIO_PULL_UP, GPIO_MEDIUM);
	gpio_alternate(pin_of(told->mosi), told->mosi_function, GPIO_PULL_UP, GPIO_MEDIUM);
	log_spi_speed(NULL, false);
	SPI_CR2(spi) = FIELD(SPI_CR2_DS, BITS_8) | SPI_CR2_FRXTH;
	dma_setup(rx, &SPI_DR(spi), DMA_FROM_PERIPHERAL, DMA_BYTE, DMA_MEDIUM, 0);
	dma_setup(tx, &SPI_DR(spi), DMA_TO_PERIPHERAL, DMA_BYTE, DMA_LOW, 0);
	return &bus;
}

const struct log_device *log_spi_start(void)
{
	const struct spi_bus *const open = log_spi_open();

	if (open == NULL)
		return NULL;
	if (board.log_kind == BOARD_LOG_CARD)
		card_log_init(&log_spi.card, open, &device);
	else
		flash_log_init(&log_spi.flash, open, &device);
	return &device;
}
