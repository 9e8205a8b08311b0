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

static uint64_t spi_byte_cycles(const struct native *n)
{
	return 8u * (2u << (n->s.words[n->spi][SPI_CR1] >> 3 & 7u)) * TIME_HZ / n->s.apb2;
}

/* Bytes in memory. */
static uint32_t spi_waiting(struct native *n)
{
	const uint32_t *const w = device_words(n, n->spi);

	return (w[SPI_CR1] & SPE) != 0u && (w[SPI_CR2] & TXDMAEN) != 0u ? native_available(n, SPI_TX) : 0u;
}

/* Bytes in the FIFO, without the one in the shift register. */
static uint32_t spi_level(const struct native *n)
{
	return n->s.sending_count - (n->s.begun != NEVER && n->s.sending_count != 0u);
}

static uint32_t spi_status(const struct native *n)
{
	static const uint8_t levels[] = {0, 1, 2, 3, 3, 3};
	const uint32_t level = spi_level(n), enough = n->s.words[n->spi][SPI_CR2] & FRXTH ? 1u : 2u;

	return (n->s.received_count >= enough ? SR_RXNE : 0u) | (level <= FIFO_BYTES / 2 ? SR_TXE : 0u) |
	       (n->s.overrun ? SR_OVR : 0u) | (n->s.begun != NEVER ? SR_BSY : 0u) |
	       (uint32_t)levels[n->s.received_count] << 9 | (uint32_t)levels[level] << 11;
}

static void spi_update(struct native *n)
{
	const uint32_t status = spi_status(n), enables = device_words(n, n->spi)[SPI_CR2];

	engine_irq(n->e, n->irqs[n->spi][0],
		   ((status & SR_RXNE) != 0u && (enables & RXNEIE) != 0u) ||
			   ((status & SR_TXE) != 0u && (enables & TXEIE) != 0u) ||
			   ((status & SR_OVR) != 0u && (enables & ERRIE) != 0u));
}

/* Fills the FIFO from memory. */
static void spi_fetch(struct native *n)
{
	const uint32_t capacity = FIFO_BYTES + (n->s.begun != NEVER);
	uint32_t item;

	while (n->s.sending_count < capacity && spi_waiting(n) != 0u && native_take(n, SPI_TX, &item, 1) == 1u)
		n->s.sending[n->s.sending_count++] = (uint8_t)item;
}

/* `count` bytes have passed: out, in, and to memory. */
static void spi_exchange(struct native *n, uint8_t *bytes, uint32_t count)
{
	const uint32_t *const w = device_words(n, n->spi);
	uint32_t items[PERIODS], given = 0;

	if (n->s.selected) {
		const double hz = (double)n->s.apb2 / (double)(2u << (w[SPI_CR1] >> 3 & 7u));
		const uint32_t mode = w[SPI_CR1] & 3u; /* CPHA, CPOL */

		if (!gyro_exchange(n, bytes, count, hz, mode))
			n->callbacks.exchange(bytes, count, n->s.transaction, hz, mode);
		if (n->bit_errors)
			n->callbacks.errors(bytes, count);
	} else {
		const uint32_t *const port = device_words(n, n->ports[0]);

		memset(bytes, (port[PUPDR] >> 12 & 3u) == 1u ? 0xFF : 0x00, count); /* MISO is PA6 */
	}
	if (w[SPI_CR2] & RXDMAEN) {
		for (uint32_t i = 0; i < count; ++i)
			items[i] = bytes[i];
		const uint32_t available = native_available(n, SPI_RX);

		given = native_give(n, SPI_RX, items, available < count ? available : count);
	}
	for (uint32_t i = given; i < count; ++i) {
		if (n->s.received_count < FIFO_BYTES)
			n->s.received[n->s.received_count++] = bytes[i];
		else
			n->s.overrun = 1;
	}
}

/* Moves up to `passed` bytes; false: the line rests. */
static bool spi_shift(struct native *n, uint64_t passed)
{
	uint8_t bytes[PERIODS];

	while (passed != 0u && !n->failed) {
		const uint32_t part = passed < PERIODS ? (uint32_t)passed : PERIODS;
		uint32_t count = 0;

		while (count < part && n->s.sending_count != 0u) {
			bytes[count++] = n->s.sending[0];
			memmove(n->s.sending, n->s.sending + 1, --n->s.sending_count);
			spi_fetch(n);
		}
		n->s.begun += count * spi_byte_cycles(n);
		passed -= count;
		spi_exchange(n, bytes, count);
		if (n->s.sending_count == 0u) {
			n->s.begun = NEVER;
			return false;
		}
	}
	return true;
}

void spi_sync(struct native *n)
{
	while (n->s.begun != NEVER && !n->failed) {
		const uint64_t passed = (native_now(n) - n->s.begun) / spi_byte_cycles(n);
		const uint64_t all = n->s.sending_count + spi_waiting(n);

		spi_fetch(n);
		if (passed == 0u || !spi_shift(n, passed < all ? passed : all))
			break;
	}
	if (n->s.begun == NEVER)
		spi_fetch(n);
	spi_update(n);
}

/* Sets the alarm for the end of the transfer, or of the byte that an interrupt waits for. */
void spi_plan(struct native *n)
{
	const uint32_t cr2 = device_words(n, n->spi)[SPI_CR2];
	uint64_t left = n->s.sending_count + spi_waiting(n);

	if (n->s.begun != NEVER && (cr2 & (RXNEIE | TXEIE)) != 0u)
		left = 1;
	else if (n->s.begun != NEVER && (cr2 & RXDMAEN) != 0u) {
		const uint32_t available = native_available(n, SPI_RX);

		left = available != 0u && available < left ? available : left;
	} else {
		engine_set_alarm(n->e, n->alarms[n->spi], NEVER);
		return;
	}
	engine_set_alarm(n->e, n->alarms[n->spi], n->s.begun + left * spi_byte_cycles(n));
}

/* Begins with what waits, if anything does. */
void spi_start(struct native *n)
{
	const uint32_t *const w = device_words(n, n->spi);

	if (n->s.begun == NEVER && (w[SPI_CR1] & SPE) != 0u) {
		spi_fetch(n);
		if (n->s.sending_count != 0u) {
			if (n->s.spi_epoch != n->s.epoch || n->s.spi_cr1 != w[SPI_CR1] || n->s.spi_cr2 != w[SPI_CR2]) {
				native_query(n, QUERY_SEND, n->spi, 0, 0);
				if (n->failed)
					return;
				n->s.spi_epoch = n->s.epoch;
				n->s.spi_cr1 = w[SPI_CR1];
				n->s.spi_cr2 = w[SPI_CR2];
			}
			n->s.begun = native_now(n);
			spi_fetch(n);
		}
	}
	spi_plan(n);
}

static void spi_driver_sync(struct native *n, uint32_t source)
{
	(void)source;
	spi_sync(n);
}

static void spi_driver_changed(struct native *n, uint32_t source)
{
	(void)source;
	spi_sync(n);
	spi_start(n);
}

static bool spi_may_have_ended(struct native *n, uint32_t source)
{
	if (n->s.begun == NEVER)
		return true;
	const uint64_t passed = (native_now(n) - n->s.begun) / spi_byte_cycles(n);

	if (source == SPI_RX)
		return passed >= native_available(n, SPI_RX);
	return n->s.sending_count + spi_waiting(n) <= passed + FIFO_BYTES + 1u;
}

const struct driver spi_driver = {
	.sync = spi_driver_sync, .changed = spi_driver_changed, .may_have_ended = spi_may_have_ended,
};

void spi_reset(struct native *n)
{
	n->s.sending_count = n->s.received_count = n->s.last = n->s.overrun = 0;
	n->s.begun = NEVER;
	engine_set_alarm(n->e, n->alarms[n->spi], NEVER);
	engine_irq(n->e, n->irqs[n->spi][0], false);
}

void native_bit_errors(struct native *n, bool any)
{
	n->bit_errors = any;
}

uint32_t spi_read(struct native *n, uint32_t word, uint32_t size)
{
	uint32_t value = 0;

	spi_sync(n);
	if (word == SPI_SR)
		return spi_status(n);
	if (word != SPI_DR)
		return device_words(n, n->spi)[word];
	for (uint32_t i = 0; i < (size < 2u ? size : 2u); ++i) {
		if (n->s.received_count != 0u) {
			n->s.last = n->s.received[0];
			memmove(n->s.received, n->s.received + 1, --n->s.received_count);
		}
		value |= n->s.last << 8u * i;
	}
	n->s.overrun = 0;
	spi_update(n);
	return value;
}

void spi_write(struct native *n, uint32_t word, uint32_t size, uint32_t value)
{
	spi_sync(n);
	if (word == SPI_CR1) {
		const uint32_t changed = device_keep(n, n->spi, word, value);

		if ((changed & SPE) != 0u && (value & SPE) == 0u) {
			n->s.sending_count = 0; /* what is on the wire is lost */
			n->s.begun = NEVER;
		} else if ((changed & ~(uint32_t)SPE) != 0u && n->s.begun != NEVER) {
			native_query(n, QUERY_BUSY, n->spi, 0, 0);
			return;
		}
	} else if (word == SPI_CR2) {
		device_keep(n, n->spi, word, value);
	} else if (word == SPI_DR) {
		for (uint32_t i = 0; i < (size < 2u ? size : 2u); ++i) {
			if (spi_level(n) >= FIFO_BYTES) {
				native_query(n, QUERY_FULL, n->spi, 0, 0);
				return;
			}
			n->s.sending[n->s.sending_count++] = (uint8_t)(value >> 8u * i);
		}
	} else {
		return;
	}
	spi_start(n);
	spi_update(n);
}
