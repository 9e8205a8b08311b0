/* SPI1 to SPI3 as masters (RM0431 SPI): bytes between the program and the chip that it has selected, each taking its eight clocks.
 *
 * One alarm marks the end of a transfer by DMA; a register that is read before shows the bytes that have passed until then. */
#include <string.h>

#include "peripherals.h"

enum { SPE = 1u << 6, RXDMAEN = 1u << 0, TXDMAEN = 1u << 1, ERRIE = 1u << 5, RXNEIE = 1u << 6, TXEIE = 1u << 7 };
enum { SPI_CR1 = 0, SPI_CR2 = 1, SPI_SR = 2 }; /* words; SPI_DR: spi.h */
enum { FRXTH = 1u << 12 };
enum { SR_RXNE = 1u << 0, SR_TXE = 1u << 1, SR_OVR = 1u << 6, SR_BSY = 1u << 7 };

static uint32_t *spi_words(struct native *n, uint32_t i)
{
	return device_words(n, n->devices[SPI][i]);
}

/* The requests of bus `i`. */
static uint32_t spi_rx(uint32_t i)
{
	return SPI1_RX + 2u * i;
}

static uint32_t spi_tx(uint32_t i)
{
	return SPI1_TX + 2u * i;
}

static uint64_t spi_byte_cycles(const struct native *n, uint32_t i)
{
	return 8u * (2u << (n->s.words[n->devices[SPI][i]][SPI_CR1] >> 3 & 7u)) * TIME_HZ / n->s.spis[i].clock;
}

/* Bytes in memory. */
static uint32_t spi_waiting(struct native *n, uint32_t i)
{
	const uint32_t *const w = spi_words(n, i);

	return (w[SPI_CR1] & SPE) != 0u && (w[SPI_CR2] & TXDMAEN) != 0u ? native_available(n, spi_tx(i)) : 0u;
}

/* Bytes in the FIFO, without the one in the shift register. */
static uint32_t spi_level(const struct native *n, uint32_t i)
{
	const struct spi *const s = &n->s.spis[i];

	return s->sending_count - (s->begun != NEVER && s->sending_count != 0u);
}

static uint32_t spi_status(const struct native *n, uint32_t i)
{
	static const uint8_t levels[] = {0, 1, 2, 3, 3, 3};
	const struct spi *const s = &n->s.spis[i];
	const uint32_t level = spi_level(n, i), enough = n->s.words[n->devices[SPI][i]][SPI_CR2] & FRXTH ? 1u : 2u;

	return (s->received_count >= enough ? SR_RXNE : 0u) | (level <= FIFO_BYTES / 2 ? SR_TXE : 0u) |
	       (s->overrun ? SR_OVR : 0u) | (s->begun != NEVER ? SR_BSY : 0u) |
	       (uint32_t)levels[s->received_count] << 9 | (uint32_t)levels[level] << 11;
}

static void spi_update(struct native *n, uint32_t i)
{
	const uint32_t enables = spi_words(n, i)[SPI_CR2];
	const uint32_t causes = (enables & RXNEIE ? SR_RXNE : 0u) | (enables & TXEIE ? SR_TXE : 0u) | (enables & ERRIE ? SR_OVR : 0u);

	engine_irq(n->e, n->irqs[n->devices[SPI][i]][0], (spi_status(n, i) & causes) != 0u);
}

/* Fills the FIFO from memory. */
static void spi_fetch(struct native *n, uint32_t i)
{
	struct spi *const s = &n->s.spis[i];
	const uint32_t capacity = FIFO_BYTES + (s->begun != NEVER);
	uint32_t item;

	while (s->sending_count < capacity && spi_waiting(n, i) != 0u && native_take(n, spi_tx(i), &item, 1) == 1u)
		s->sending[s->sending_count++] = (uint8_t)item;
}

/* The chip that is selected; CHIPS: none is. Fails if two are. */
static uint32_t spi_selected(struct native *n, uint32_t i)
{
	uint32_t found = CHIPS;

	for (uint32_t k = 0; k < n->chip_count; ++k) {
		if (n->places[k].spi != i || !n->s.chips[k].selected)
			continue;
		if (found != CHIPS) {
			const struct place *const one = &n->places[found], *const other = &n->places[k];

			native_query(n, QUERY_SELECTED, n->devices[SPI][i], (uint32_t)one->port << 4 | one->pin,
				     (uint32_t)other->port << 4 | other->pin);
		}
		found = k;
	}
	return found;
}

/* `count` bytes pass that begin at `cycle`; what the chip on the bus answers takes their place. */
static void spi_answer(struct native *n, uint32_t i, uint8_t *bytes, uint32_t count, uint64_t cycle)
{
	const struct spi *const s = &n->s.spis[i];
	const uint32_t cr1 = spi_words(n, i)[SPI_CR1], mode = cr1 & 3u; /* CPHA, CPOL */
	const double hz = (double)s->clock / (double)(2u << (cr1 >> 3 & 7u));
	const uint32_t chip = spi_selected(n, i);

	if (chip < CHIPS && chip == n->gyro_chip) {
		if (!gyro_exchange(n, bytes, count, hz, mode))
			n->callbacks.exchange(bytes, count, n->s.chips[chip].transaction, hz, mode);
		if (n->bit_errors)
			n->callbacks.errors(bytes, count);
	} else if (n->log_chip < CHIPS && n->places[n->log_chip].spi == i && (chip == CHIPS || chip == n->log_chip)) {
		const uint32_t length = (uint32_t)spi_byte_cycles(n, i); /* it hears clocks while it is not selected, too */

		if (!card_exchange(n, bytes, count, cycle, length))
			n->callbacks.card(bytes, count, cycle, length, hz, mode);
	} else {
		const struct pin *const miso = &n->miso[i];
		const uint32_t pull = miso->port == NO_PORT ? 0u : device_words(n, n->devices[PORT][miso->port])[PUPDR];

		memset(bytes, (pull >> 2u * miso->pin & 3u) == 1u ? 0xFF : 0x00, count);
	}
}

/* `count` bytes have passed, the first from `cycle` on: out, in, and to memory. */
static void spi_exchange(struct native *n, uint32_t i, uint8_t *bytes, uint32_t count, uint64_t cycle)
{
	struct spi *const s = &n->s.spis[i];
	uint32_t items[PERIODS], given = 0;

	spi_answer(n, i, bytes, count, cycle);
	if (spi_words(n, i)[SPI_CR2] & RXDMAEN) {
		for (uint32_t k = 0; k < count; ++k)
			items[k] = bytes[k];
		const uint32_t available = native_available(n, spi_rx(i));

		given = native_give(n, spi_rx(i), items, available < count ? available : count);
	}
	for (uint32_t k = given; k < count; ++k) {
		if (s->received_count < FIFO_BYTES)
			s->received[s->received_count++] = bytes[k];
		else
			s->overrun = 1;
	}
}

/* Moves up to `passed` bytes; false: the line rests. */
static bool spi_shift(struct native *n, uint32_t i, uint64_t passed)
{
	struct spi *const s = &n->s.spis[i];
	uint8_t bytes[PERIODS];

	while (passed != 0u && !n->failed) {
		const uint32_t part = passed < PERIODS ? (uint32_t)passed : PERIODS;
		const uint64_t cycle = s->begun;
		uint32_t count = 0;

		while (count < part && s->sending_count != 0u) {
			bytes[count++] = s->sending[0];
			memmove(s->sending, s->sending + 1, --s->sending_count);
			spi_fetch(n, i);
		}
		s->begun += count * spi_byte_cycles(n, i);
		passed -= count;
		spi_exchange(n, i, bytes, count, cycle);
		if (s->sending_count == 0u) {
			s->begun = NEVER;
			return false;
		}
	}
	return true;
}

void spi_sync(struct native *n, uint32_t i)
{
	const struct spi *const s = &n->s.spis[i];

	while (s->begun != NEVER && !n->failed) {
		const uint64_t passed = (native_now(n) - s->begun) / spi_byte_cycles(n, i);
		const uint64_t all = s->sending_count + spi_waiting(n, i);

		spi_fetch(n, i);
		if (passed == 0u || !spi_shift(n, i, passed < all ? passed : all))
			break;
	}
	if (s->begun == NEVER)
		spi_fetch(n, i);
	spi_update(n, i);
}

/* Sets the alarm for the end of the transfer, or of the byte that an interrupt waits for. */
void spi_plan(struct native *n, uint32_t i)
{
	const struct spi *const s = &n->s.spis[i];
	const uint32_t cr2 = spi_words(n, i)[SPI_CR2];
	const uint64_t waiting = spi_waiting(n, i);
	uint64_t left = 0; /* bytes until something shows by itself; 0: nothing does */

	if (s->begun != NEVER) {
		if ((cr2 & RXDMAEN) != 0u) {
			const uint32_t available = native_available(n, spi_rx(i));

			left = s->sending_count + waiting;
			left = available != 0u && available < left ? available : left;
		}
		if (waiting != 0u && native_rings(n, spi_tx(i)) && (left == 0u || waiting < left))
			left = waiting; /* the last one goes into the FIFO as that many have left it */
		if ((cr2 & (RXNEIE | TXEIE)) != 0u)
			left = 1;
	}
	engine_set_alarm(n->e, n->alarms[n->devices[SPI][i]], left == 0u ? NEVER : s->begun + left * spi_byte_cycles(n, i));
}

/* Begins with what waits, if anything does. */
void spi_start(struct native *n, uint32_t i)
{
	struct spi *const s = &n->s.spis[i];
	const uint32_t *const w = spi_words(n, i);

	if (s->begun == NEVER && (w[SPI_CR1] & SPE) != 0u) {
		spi_fetch(n, i);
		if (s->sending_count != 0u) {
			if (s->epoch != n->s.epoch || s->cr1 != w[SPI_CR1] || s->cr2 != w[SPI_CR2]) {
				native_query(n, QUERY_SEND, n->devices[SPI][i], 0, 0);
				if (n->failed)
					return;
				s->epoch = n->s.epoch;
				s->cr1 = w[SPI_CR1];
				s->cr2 = w[SPI_CR2];
			}
			s->begun = native_now(n);
			spi_fetch(n, i);
		}
	}
	spi_plan(n, i);
}

static void spi_driver_sync(struct native *n, uint32_t source)
{
	spi_sync(n, source / 2u);
}

static void spi_driver_changed(struct native *n, uint32_t source)
{
	spi_sync(n, source / 2u);
	spi_start(n, source / 2u);
}

static bool spi_may_have_ended(struct native *n, uint32_t source)
{
	const uint32_t i = source / 2u;
	const struct spi *const s = &n->s.spis[i];

	if (s->begun == NEVER)
		return true;
	const uint64_t passed = (native_now(n) - s->begun) / spi_byte_cycles(n, i);

	if (source == spi_rx(i))
		return passed >= native_available(n, source);
	return s->sending_count + spi_waiting(n, i) <= passed + FIFO_BYTES + 1u;
}

const struct driver spi_driver = {
	.sync = spi_driver_sync, .changed = spi_driver_changed, .may_have_ended = spi_may_have_ended,
};

void spi_reset(struct native *n, uint32_t i)
{
	struct spi *const s = &n->s.spis[i];

	s->sending_count = s->received_count = s->last = s->overrun = 0;
	s->begun = NEVER;
	engine_set_alarm(n->e, n->alarms[n->devices[SPI][i]], NEVER);
	engine_irq(n->e, n->irqs[n->devices[SPI][i]][0], false);
}

void native_bit_errors(struct native *n, bool any)
{
	n->bit_errors = any;
}

uint32_t spi_read(struct native *n, uint32_t i, uint32_t word, uint32_t size)
{
	struct spi *const s = &n->s.spis[i];
	uint32_t value = 0;

	spi_sync(n, i);
	if (word == SPI_SR)
		return spi_status(n, i);
	if (word != SPI_DR)
		return spi_words(n, i)[word];
	for (uint32_t k = 0; k < (size < 2u ? size : 2u); ++k) {
		if (s->received_count != 0u) {
			s->last = s->received[0];
			memmove(s->received, s->received + 1, --s->received_count);
		}
		value |= s->last << 8u * k;
	}
	s->overrun = 0;
	spi_update(n, i);
	return value;
}

void spi_write(struct native *n, uint32_t i, uint32_t word, uint32_t size, uint32_t value)
{
	struct spi *const s = &n->s.spis[i];

	spi_sync(n, i);
	if (word == SPI_CR1) {
		const uint32_t changed = device_keep(n, n->devices[SPI][i], word, value);

		if ((changed & SPE) != 0u && (value & SPE) == 0u) {
			s->sending_count = 0; /* what is on the wire is lost */
			s->begun = NEVER;
		} else if ((changed & ~(uint32_t)SPE) != 0u && s->begun != NEVER) {
			native_query(n, QUERY_BUSY, n->devices[SPI][i], 0, 0);
			return;
		}
	} else if (word == SPI_CR2) {
		device_keep(n, n->devices[SPI][i], word, value);
	} else if (word == SPI_DR) {
		for (uint32_t k = 0; k < (size < 2u ? size : 2u); ++k) {
			if (spi_level(n, i) >= FIFO_BYTES) {
				native_query(n, QUERY_FULL, n->devices[SPI][i], 0, 0);
				return;
			}
			s->sending[s->sending_count++] = (uint8_t)(value >> 8u * k);
		}
	} else {
		return;
	}
	spi_start(n, i);
	spi_update(n, i);
}
