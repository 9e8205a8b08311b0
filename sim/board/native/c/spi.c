/* SPI1 in C: sim/board/peripherals/spi.py says what it does and why. */
#include <string.h>

#include "native.h"

enum { SPE = 1u << 6, RXDMAEN = 1u << 0, TXDMAEN = 1u << 1, ERRIE = 1u << 5, RXNEIE = 1u << 6, TXEIE = 1u << 7 };
enum { FRXTH = 1u << 12 };
enum { SR_RXNE = 1u << 0, SR_TXE = 1u << 1, SR_OVR = 1u << 6, SR_BSY = 1u << 7 };

uint64_t byte_cycles(const struct hot *h)
{
	return 8u * (2u << (h->s.words[h->spi][SPI_CR1] >> 3 & 7u)) * TIME_HZ / h->s.apb2;
}

uint32_t spi_waiting(struct hot *h)
{
	const uint32_t *const w = words(h, h->spi);

	return (w[SPI_CR1] & SPE) != 0u && (w[SPI_CR2] & TXDMAEN) != 0u ? hot_available(h, SPI_TX) : 0u;
}

/* Bytes in the FIFO, without the one in the shift register. */
static uint32_t spi_level(const struct hot *h)
{
	return h->s.sending_count - (h->s.begun != NEVER && h->s.sending_count != 0u);
}

static uint32_t spi_status(const struct hot *h)
{
	static const uint8_t levels[] = {0, 1, 2, 3, 3, 3};
	const uint32_t level = spi_level(h), enough = h->s.words[h->spi][SPI_CR2] & FRXTH ? 1u : 2u;

	return (h->s.received_count >= enough ? SR_RXNE : 0u) | (level <= FIFO_BYTES / 2 ? SR_TXE : 0u) |
	       (h->s.overrun ? SR_OVR : 0u) | (h->s.begun != NEVER ? SR_BSY : 0u) |
	       (uint32_t)levels[h->s.received_count] << 9 | (uint32_t)levels[level] << 11;
}

static void spi_update(struct hot *h)
{
	const uint32_t status = spi_status(h), enables = words(h, h->spi)[SPI_CR2];

	engine_irq(h->e, h->irqs[h->spi][0],
		   ((status & SR_RXNE) != 0u && (enables & RXNEIE) != 0u) ||
			   ((status & SR_TXE) != 0u && (enables & TXEIE) != 0u) ||
			   ((status & SR_OVR) != 0u && (enables & ERRIE) != 0u));
}

/* Fills the FIFO from memory. */
static void spi_fetch(struct hot *h)
{
	const uint32_t capacity = FIFO_BYTES + (h->s.begun != NEVER);
	uint32_t item;

	while (h->s.sending_count < capacity && spi_waiting(h) != 0u && hot_take(h, SPI_TX, &item, 1) == 1u)
		h->s.sending[h->s.sending_count++] = (uint8_t)item;
}

/* `count` bytes have passed: out, in, and to memory. */
static void spi_exchange(struct hot *h, uint8_t *bytes, uint32_t count)
{
	const uint32_t *const w = words(h, h->spi);
	uint32_t items[PERIODS], given = 0;

	if (h->s.selected) {
		const double hz = (double)h->s.apb2 / (double)(2u << (w[SPI_CR1] >> 3 & 7u));
		const uint32_t mode = w[SPI_CR1] & 3u; /* CPHA, CPOL */

		if (!gyro_exchange(h, bytes, count, hz, mode))
			h->exchange(bytes, count, h->s.transaction, hz, mode);
	} else {
		const uint32_t *const port = words(h, h->ports[0]);

		memset(bytes, (port[PUPDR] >> 12 & 3u) == 1u ? 0xFF : 0x00, count); /* MISO is PA6 */
	}
	if (w[SPI_CR2] & RXDMAEN) {
		for (uint32_t i = 0; i < count; ++i)
			items[i] = bytes[i];
		const uint32_t available = hot_available(h, SPI_RX);

		given = hot_give(h, SPI_RX, items, available < count ? available : count);
	}
	for (uint32_t i = given; i < count; ++i) {
		if (h->s.received_count < FIFO_BYTES)
			h->s.received[h->s.received_count++] = bytes[i];
		else
			h->s.overrun = 1;
	}
}

/* Moves up to `passed` bytes; false: the line rests. */
static bool spi_shift(struct hot *h, uint64_t passed)
{
	uint8_t bytes[PERIODS];

	while (passed != 0u && !h->failed) {
		const uint32_t part = passed < PERIODS ? (uint32_t)passed : PERIODS;
		uint32_t count = 0;

		while (count < part && h->s.sending_count != 0u) {
			bytes[count++] = h->s.sending[0];
			memmove(h->s.sending, h->s.sending + 1, --h->s.sending_count);
			spi_fetch(h);
		}
		h->s.begun += count * byte_cycles(h);
		passed -= count;
		spi_exchange(h, bytes, count);
		if (h->s.sending_count == 0u) {
			h->s.begun = NEVER;
			return false;
		}
	}
	return true;
}

void spi_sync(struct hot *h)
{
	while (h->s.begun != NEVER && !h->failed) {
		const uint64_t passed = (now(h) - h->s.begun) / byte_cycles(h);
		const uint64_t all = h->s.sending_count + spi_waiting(h);

		spi_fetch(h);
		if (passed == 0u || !spi_shift(h, passed < all ? passed : all))
			break;
	}
	if (h->s.begun == NEVER)
		spi_fetch(h);
	spi_update(h);
}

void spi_plan(struct hot *h)
{
	const uint32_t cr2 = words(h, h->spi)[SPI_CR2];
	uint64_t left = h->s.sending_count + spi_waiting(h);

	if (h->s.begun != NEVER && (cr2 & (RXNEIE | TXEIE)) != 0u)
		left = 1;
	else if (h->s.begun != NEVER && (cr2 & RXDMAEN) != 0u) {
		const uint32_t available = hot_available(h, SPI_RX);

		left = available != 0u && available < left ? available : left;
	} else {
		engine_set_alarm(h->e, h->alarms[h->spi], NEVER);
		return;
	}
	engine_set_alarm(h->e, h->alarms[h->spi], h->s.begun + left * byte_cycles(h));
}

void spi_start(struct hot *h)
{
	const uint32_t *const w = words(h, h->spi);

	if (h->s.begun == NEVER && (w[SPI_CR1] & SPE) != 0u) {
		spi_fetch(h);
		if (h->s.sending_count != 0u) {
			if (h->s.spi_epoch != h->s.epoch || h->s.spi_cr1 != w[SPI_CR1] || h->s.spi_cr2 != w[SPI_CR2]) {
				ask(h, ASK_SPI, 0, 0, 0);
				if (h->failed)
					return;
				h->s.spi_epoch = h->s.epoch;
				h->s.spi_cr1 = w[SPI_CR1];
				h->s.spi_cr2 = w[SPI_CR2];
			}
			h->s.begun = now(h);
			spi_fetch(h);
		}
	}
	spi_plan(h);
}

void spi_dma_changed(struct hot *h)
{
	spi_sync(h);
	spi_start(h);
}

uint32_t spi_read(struct hot *h, uint32_t slot, uint32_t size)
{
	uint32_t value = 0;

	spi_sync(h);
	if (slot == SPI_SR)
		return spi_status(h);
	if (slot != SPI_DR)
		return words(h, h->spi)[slot];
	for (uint32_t i = 0; i < (size < 2u ? size : 2u); ++i) {
		if (h->s.received_count != 0u) {
			h->s.last = h->s.received[0];
			memmove(h->s.received, h->s.received + 1, --h->s.received_count);
		}
		value |= h->s.last << 8u * i;
	}
	h->s.overrun = 0;
	spi_update(h);
	return value;
}

void spi_write(struct hot *h, uint32_t slot, uint32_t size, uint32_t value)
{
	spi_sync(h);
	if (slot == SPI_CR1) {
		const uint32_t changed = keep(h, h->spi, slot, value);

		if ((changed & SPE) != 0u && (value & SPE) == 0u) {
			h->s.sending_count = 0; /* what is on the wire is lost */
			h->s.begun = NEVER;
		} else if ((changed & ~(uint32_t)SPE) != 0u && h->s.begun != NEVER) {
			ask(h, ASK_SPI_BUSY, 0, 0, 0);
			return;
		}
	} else if (slot == SPI_CR2) {
		keep(h, h->spi, slot, value);
	} else if (slot == SPI_DR) {
		for (uint32_t i = 0; i < (size < 2u ? size : 2u); ++i) {
			if (spi_level(h) >= FIFO_BYTES) {
				ask(h, ASK_SPI_FULL, 0, 0, 0);
				return;
			}
			h->s.sending[h->s.sending_count++] = (uint8_t)(value >> 8u * i);
		}
	} else {
		return;
	}
	spi_start(h);
	spi_update(h);
}
