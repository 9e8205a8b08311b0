#include "hal/stm32f7/peripherals/spi.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"

enum { BITS_8 = 7 }; /* SPI_CR2 DS */

/* A byte at the slowest speed takes 9.5 us. */
#define BYTE_LIMIT (CLOCK_CORE_HZ / 50000u) /* 20 us */

/* The data register as a byte: a wider access would send two (RM0431 SPI, data packing). */
#define DATA_BYTE (*(volatile uint8_t *)&SPI_DR(spi.at))

/* Set by spi_open. */
static struct {
	uint32_t at; /* registers */
	struct dma_stream rx, tx;
} spi;

uint32_t spi_at(uint32_t number)
{
	static const uint32_t places[NF_BOARD_SPI_COUNT] = { SPI1, SPI2, SPI3 };

	return number - 1u < NF_BOARD_SPI_COUNT ? places[number - 1u] : 0u;
}

bool spi_open(uint32_t number)
{
	if (spi_at(number) == 0u)
		return false;
	const struct board_bus *const bus = &board.buses[number - 1u];

	spi.at = spi_at(number);
	spi.rx = stream_of(bus->dma_rx);
	spi.tx = stream_of(bus->dma_tx);
	if (spi.rx.at == 0u || spi.tx.at == 0u)
		return false;
	/* The pull-up keeps the clock at its rest level while the SPI is off (RM0431 SPI, clock polarity). */
	gpio_alternate(pin_of(bus->sck), bus->sck_function, GPIO_PULL_UP, GPIO_FAST);
	gpio_alternate(pin_of(bus->miso), bus->miso_function, GPIO_PULL_UP, GPIO_FAST);
	gpio_alternate(pin_of(bus->mosi), bus->mosi_function, GPIO_FLOATING, GPIO_FAST);
	return true;
}

void spi_configure(enum spi_speed speed)
{
	const uint32_t divider = spi.at == SPI1 ? speed : speed - 1u;

	SPI_CR1(spi.at) = SPI_CR1_CPHA | SPI_CR1_CPOL | SPI_CR1_MSTR | SPI_CR1_SSM | SPI_CR1_SSI |
			  FIELD(SPI_CR1_BR, divider);
	SPI_CR2(spi.at) = FIELD(SPI_CR2_DS, BITS_8) | SPI_CR2_FRXTH;
}
_Static_assert(CLOCK_APB2_HZ == 2u * CLOCK_APB1_HZ, "one step of the divider");

/* Disabling asks for an empty transmit FIFO and a resting line (RM0431 SPI, procedure for disabling). */
static bool spi_disable(void)
{
	const bool sent = time_wait(&SPI_SR(spi.at), SPI_SR_FTLVL, 0, BYTE_LIMIT) &&
			  time_wait(&SPI_SR(spi.at), SPI_SR_BSY, 0, BYTE_LIMIT);

	SPI_CR1(spi.at) &= ~SPI_CR1_SPE;
	for (uint32_t left = 4; left != 0u && (SPI_SR(spi.at) & SPI_SR_FRLVL) != 0u; --left)
		(void)DATA_BYTE; /* the receive FIFO holds 4 bytes */
	return sent;
}

bool spi_exchange(uint8_t *bytes, size_t count)
{
	bool moved = true;

	SPI_CR1(spi.at) |= SPI_CR1_SPE;
	for (size_t i = 0; i < count && moved; ++i) {
		moved = time_wait(&SPI_SR(spi.at), SPI_SR_TXE, SPI_SR_TXE, BYTE_LIMIT);
		if (!moved)
			break;
		DATA_BYTE = bytes[i];
		moved = time_wait(&SPI_SR(spi.at), SPI_SR_RXNE, SPI_SR_RXNE, BYTE_LIMIT);
		if (moved)
			bytes[i] = DATA_BYTE;
	}
	return spi_disable() && moved;
}

struct dma_stream spi_dma_setup(void)
{
	dma_setup(spi.rx, &SPI_DR(spi.at), DMA_FROM_PERIPHERAL, DMA_BYTE, DMA_HIGH, DMA_SCR_TCIE | DMA_SCR_TEIE);
	dma_setup(spi.tx, &SPI_DR(spi.at), DMA_TO_PERIPHERAL, DMA_BYTE, DMA_MEDIUM, 0);
	return spi.rx;
}

/* The order is the manual's (RM0431 SPI, communication using DMA). */
bool spi_start(const volatile uint8_t *send, volatile uint8_t *receive, uint32_t count)
{
	if (dma_busy(spi.rx) || dma_busy(spi.tx))
		return false;
	SPI_CR2(spi.at) |= SPI_CR2_RXDMAEN;
	dma_start(spi.rx, receive, count);
	dma_start(spi.tx, send, count);
	SPI_CR2(spi.at) |= SPI_CR2_TXDMAEN;
	SPI_CR1(spi.at) |= SPI_CR1_SPE;
	return true;
}

bool spi_finish(void)
{
	const bool tx_free = dma_stop(spi.tx);
	const bool rx_free = dma_stop(spi.rx);
	const bool rested = spi_disable();

	SPI_CR2(spi.at) &= ~(SPI_CR2_RXDMAEN | SPI_CR2_TXDMAEN);
	dma_clear(spi.tx);
	dma_clear(spi.rx);
	barrier();
	return tx_free && rx_free && rested;
}
