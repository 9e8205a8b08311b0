#include "hal/stm32f7/peripherals/spi.h"

#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/peripherals/dma.h"

enum { BITS_8 = 7 }; /* SPI_CR2 DS */

/* A byte at the slowest speed takes 9.5 us. */
#define BYTE_LIMIT (CLOCK_CORE_HZ / 50000u) /* 20 us */

/* The data register as a byte: a wider access would send two (RM0431 SPI, data packing). */
#define DATA_BYTE (*(volatile uint8_t *)&SPI_DR(SPI1))

void spi_configure(enum spi_speed speed)
{
	SPI_CR1(SPI1) = SPI_CR1_CPHA | SPI_CR1_CPOL | SPI_CR1_MSTR | SPI_CR1_SSM | SPI_CR1_SSI |
			FIELD(SPI_CR1_BR, speed);
	SPI_CR2(SPI1) = FIELD(SPI_CR2_DS, BITS_8) | SPI_CR2_FRXTH;
}

/* Disabling asks for an empty transmit FIFO and a resting line (RM0431 SPI, procedure for disabling). */
static bool spi_disable(void)
{
	const bool sent = time_wait(&SPI_SR(SPI1), SPI_SR_FTLVL, 0, BYTE_LIMIT) &&
			  time_wait(&SPI_SR(SPI1), SPI_SR_BSY, 0, BYTE_LIMIT);

	SPI_CR1(SPI1) &= ~SPI_CR1_SPE;
	for (uint32_t left = 4; left != 0u && (SPI_SR(SPI1) & SPI_SR_FRLVL) != 0u; --left)
		(void)DATA_BYTE; /* the receive FIFO holds 4 bytes */
	return sent;
}

bool spi_exchange(uint8_t *bytes, size_t count)
{
	bool moved = true;

	SPI_CR1(SPI1) |= SPI_CR1_SPE;
	for (size_t i = 0; i < count && moved; ++i) {
		moved = time_wait(&SPI_SR(SPI1), SPI_SR_TXE, SPI_SR_TXE, BYTE_LIMIT);
		if (!moved)
			break;
		DATA_BYTE = bytes[i];
		moved = time_wait(&SPI_SR(SPI1), SPI_SR_RXNE, SPI_SR_RXNE, BYTE_LIMIT);
		if (moved)
			bytes[i] = DATA_BYTE;
	}
	return spi_disable() && moved;
}

void spi_dma_setup(void)
{
	dma_setup(DMA_GYRO_RX, &SPI_DR(SPI1), DMA_FROM_PERIPHERAL, DMA_BYTE, DMA_HIGH, DMA_SCR_TCIE | DMA_SCR_TEIE);
	dma_setup(DMA_GYRO_TX, &SPI_DR(SPI1), DMA_TO_PERIPHERAL, DMA_BYTE, DMA_MEDIUM, 0);
}

/* The order is the manual's (RM0431 SPI, communication using DMA). */
bool spi_start(const volatile uint8_t *send, volatile uint8_t *receive, uint32_t count)
{
	if (dma_busy(DMA_GYRO_RX) || dma_busy(DMA_GYRO_TX))
		return false;
	SPI_CR2(SPI1) |= SPI_CR2_RXDMAEN;
	dma_start(DMA_GYRO_RX, receive, count);
	dma_start(DMA_GYRO_TX, send, count);
	SPI_CR2(SPI1) |= SPI_CR2_TXDMAEN;
	SPI_CR1(SPI1) |= SPI_CR1_SPE;
	return true;
}

bool spi_finish(void)
{
	const bool tx_free = dma_stop(DMA_GYRO_TX);
	const bool rx_free = dma_stop(DMA_GYRO_RX);
	const bool rested = spi_disable();

	SPI_CR2(SPI1) &= ~(SPI_CR2_RXDMAEN | SPI_CR2_TXDMAEN);
	dma_clear(DMA_GYRO_TX);
	dma_clear(DMA_GYRO_RX);
	barrier();
	return tx_free && rx_free && rested;
}
