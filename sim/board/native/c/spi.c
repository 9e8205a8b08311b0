/* SPI1 as master (RM0431 SPI): bytes between the program and the chip on the bus, each taking its eight clocks.
 *
 * One alarm marks the end of a transfer by DMA; a register that is read before shows the bytes that have passed until then. */
#include <string.h>

#include "gyro_chip.h"
#include "pins.h"
#include "spi.h"

enum { SPE = 1u << 6, RXDMAEN = 1u << 0, TXDMAEN = 1u << 1, ERRIE = 1u << 5, RXNEIE = 1u << 6, TXEIE = 1u << 7 };
enum { SPI_CR1 = 0, SPI_CR2 = 1, SPI_SR = 2 }; /* words; SPI_DR: spi.h */
enum { FRXTH = 1u << 12 };
enum { SR_RXNE = 1u << 0, SR_TXE = 1u << 1, SR_OVR = 1u << 6, SR_BSY = 1u << 7 };

static uint64_t spi_byte_cycles(const struct native *h)
{
	return 8u * (2u << (h->s.words[h->spi][SPI_CR1] >> 3 & 7u)) * TIME_HZ / h->s.apb2;
}

/* Bytes in memory. */
static uint32_t spi_waiting(struct native *h)
{
	const uint32_t *const w = device_words(h, h->spi);

	return (w[SPI_CR1] & SPE) != 0u && (w[SPI_CR2] & TXDMAEN) != 0u ? native_available(h, SPI_TX) : 0u;
}

/* Bytes in the FIFO, without the one in the shift register. */
static uint32_t spi_level(const struct native *h)
{
	return h->s.sending_count - (h->s.begun != NEVER && h->s.sending_count != 0u);
}

static uint32_t spi_status(const struct native *h)
{
	static const uint8_t levels[] = {0, 1, 2, 3, 3, 3};
	const uint32_t level = spi_level(h), enough = h->s.words[h->spi][SPI_CR2] & FRXTH ? 1u : 2u;

	return (h->s.received_count >= enough ? SR_RXNE : 0u) | (level <= FIFO_BYTES / 2 ? SR_TXE : 0u) |
	       (h->s.overrun ? SR_OVR : 0u) | (h->s.begun != NEVER ? SR_BSY : 0u) |
	       (uint32_t)levels[h->s.received_count] << 9 | (uint32_t)levels[level] << 11;
}

static void spi_update(struct native *h)
{
	const uint32_t status = spi_status(h), enables = device_words(h, h->spi)[SPI_CR2];

	engine_irq(h->e, h->irqs[h->spi][0],
		   ((status & SR_RXNE) != 0u && (enables & RXNEIE) != 0u) ||
			   ((status & SR_TXE) != 0u && (enables & TXEIE) != 0u) ||
			   ((status & SR_OVR) != 0u && (enables & ERRIE) != 0u));
}

/* Fills the FIFO from memory. */
static void spi_fetch(struct native *h)
{
	const uint32_t capacity = FIFO_BYTES + (h->s.begun != NEVER);
	uint32_t item;

	while (h->s.sending_count < capacity && spi_waiting(h) != 0u && native_take(h, SPI_TX, &item, 1) == 1u)
		h->s.sending[h->s.sending_count++] = (uint8_t)item;
}

/* `count` bytes have passed: out, in, and to memory. */
static void spi_exchange(struct native *h, uint8_t *bytes, uint32_t count)
{
	const uint32_t *const w = device_words(h, h->spi);
	uint32_t items[PERIODS], given = 0;

	if (h->s.selected) {
		const double hz = (double)h->s.apb2 / (double)(2u << (w[SPI_CR1] >> 3 & 7u));
		const uint32_t mode = w[SPI_CR1] & 3u; /* CPHA, CPOL */

		if (!gyro_exchange(h, bytes, count, hz, mode))
			h->callbacks.exchange(bytes, count, h->s.transaction, hz, mode);
		if (h->bit_errors)
			h->callbacks.errors(bytes, count);
	} else {
		const uint32_t *const port = device_words(h, h->ports[0]);

		memset(bytes, (port[PUPDR] >> 12 & 3u) == 1u ? 0xFF : 0x00, count); /* MISO is PA6 */
	}
	if (w[SPI_CR2] & RXDMAEN) {
		for (uint32_t i = 0; i < count; ++i)
			items[i] = bytes[i];
		const uint32_t available = native_available(h, SPI_RX);

		given = native_give(h, SPI_RX, items, available < count ? available : count);
	}
	for (uint32_t i = given; i < count; ++i) {
		if (h->s.received_count < FIFO_BYTES)
			h->s.received[h->s.received_count++] = bytes[i];
		else
			h->s.overrun = 1;
	}
}

/* Moves up to `passed` bytes; false: the line rests. */
static bool spi_shift(struct native *h, uint64_t passed)
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
		h->s.begun += count * spi_byte_cycles(h);
		passed -= count;
		spi_exchange(h, bytes, count);
		if (h->s.sending_count == 0u) {
			h->s.begun = NEVER;
			return false;
		}
	}
	return true;
}

void spi_sync(struct native *h)
{
	while (h->s.begun != NEVER && !h->failed) {
		const uint64_t passed = (native_now(h) - h->s.begun) / spi_byte_cycles(h);
		const uint64_t all = h->s.sending_count + spi_waiting(h);

		spi_fetch(h);
		if (passed == 0u || !spi_shift(h, passed < all ? passed : all))
			break;
	}
	if (h->s.begun == NEVER)
		spi_fetch(h);
	spi_update(h);
}

/* Sets the alarm for the end of the transfer, or of the byte that an interrupt waits for. */
void spi_plan(struct native *h)
{
	const uint32_t cr2 = device_words(h, h->spi)[SPI_CR2];
	uint64_t left = h->s.sending_count + spi_waiting(h);

	if (h->s.begun != NEVER && (cr2 & (RXNEIE | TXEIE)) != 0u)
		left = 1;
	else if (h->s.begun != NEVER && (cr2 & RXDMAEN) != 0u) {
		const uint32_t available = native_available(h, SPI_RX);

		left = available != 0u && available < left ? available : left;
	} else {
		engine_set_alarm(h->e, h->alarms[h->spi], NEVER);
		return;
	}
	engine_set_alarm(h->e, h->alarms[h->spi], h->s.begun + left * spi_byte_cycles(h));
}

/* Begins with what waits, if anything does. */
void spi_start(struct native *h)
{
	const uint32_t *const w = device_words(h, h->spi);

	if (h->s.begun == NEVER && (w[SPI_CR1] & SPE) != 0u) {
		spi_fetch(h);
		if (h->s.sending_count != 0u) {
			if (h->s.spi_epoch != h->s.epoch || h->s.spi_cr1 != w[SPI_CR1] || h->s.spi_cr2 != w[SPI_CR2]) {
				native_query(h, QUERY_SEND, h->spi, 0, 0);
				if (h->failed)
					return;
				h->s.spi_epoch = h->s.epoch;
				h->s.spi_cr1 = w[SPI_CR1];
				h->s.spi_cr2 = w[SPI_CR2];
			}
			h->s.begun = native_now(h);
			spi_fetch(h);
		}
	}
	spi_plan(h);
}

static void spi_driver_sync(struct native *h, uint32_t source)
{
	(void)source;
	spi_sync(h);
}

static void spi_driver_changed(struct native *h, uint32_t source)
{
	(void)source;
	spi_sync(h);
	spi_start(h);
}

static bool spi_may_have_ended(struct native *h, uint32_t source)
{
	if (h->s.begun == NEVER)
		return true;
	const uint64_t passed = (native_now(h) - h->s.begun) / spi_byte_cycles(h);

	if (source == SPI_RX)
		return passed >= native_available(h, SPI_RX);
	return h->s.sending_count + spi_waiting(h) <= passed + FIFO_BYTES + 1u;
}

const struct driver spi_driver = {
	.sync = spi_driver_sync, .changed = spi_driver_changed, .may_have_ended = spi_may_have_ended,
};

void spi_reset(struct native *h)
{
	h->s.sending_count = h->s.received_count = h->s.last = h->s.overrun = 0;
	h->s.begun = NEVER;
	engine_set_alarm(h->e, h->alarms[h->spi], NEVER);
	engine_irq(h->e, h->irqs[h->spi][0], false);
}

void native_bit_errors(struct native *h, bool any)
{
	h->bit_errors = any;
}

uint32_t spi_read(struct native *h, uint32_t word, uint32_t size)
{
	uint32_t value = 0;

	spi_sync(h);
	if (word == SPI_SR)
		return spi_status(h);
	if (word != SPI_DR)
		return device_words(h, h->spi)[word];
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

void spi_write(struct native *h, uint32_t word, uint32_t size, uint32_t value)
{
	spi_sync(h);
	if (word == SPI_CR1) {
		const uint32_t changed = device_keep(h, h->spi, word, value);

		if ((changed & SPE) != 0u && (value & SPE) == 0u) {
			h->s.sending_count = 0; /* what is on the wire is lost */
			h->s.begun = NEVER;
		} else if ((changed & ~(uint32_t)SPE) != 0u && h->s.begun != NEVER) {
			native_query(h, QUERY_BUSY, h->spi, 0, 0);
			return;
		}
	} else if (word == SPI_CR2) {
		device_keep(h, h->spi, word, value);
	} else if (word == SPI_DR) {
		for (uint32_t i = 0; i < (size < 2u ? size : 2u); ++i) {
			if (spi_level(h) >= FIFO_BYTES) {
				native_query(h, QUERY_FULL, h->spi, 0, 0);
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
