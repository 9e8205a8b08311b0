/* GPIO and EXTI (RM0431 6 and 11): levels of pins, edges, pending bits and interrupts. */
#include "peripherals.h"

/* ---- EXTI ---- */

enum { EXTI_IMR = 0, EXTI_RTSR = 2, EXTI_FTSR = 3, EXTI_SWIER = 4, EXTI_PR = 5 };

void exti_update(struct native *n)
{
	static const uint32_t lines[STREAMS] = {1u << 0, 1u << 1, 1u << 2, 1u << 3, 1u << 4, 0x03E0u, 0xFC00u, 1u << 16};
	const uint32_t *const w = device_words(n, n->devices[EXTI][0]);
	const uint32_t pending = w[EXTI_PR] & w[EXTI_IMR], changed = pending ^ n->s.exti_asserted;

	n->s.exti_asserted = pending;
	for (uint32_t i = 0; changed != 0u && i < STREAMS; ++i)
		if (changed & lines[i])
			engine_irq(n->e, n->irqs[n->devices[EXTI][0]][i], (pending & lines[i]) != 0u);
}

bool exti_watches_fall(const struct native *n, uint32_t line)
{
	return n->s.words[n->devices[EXTI][0]][EXTI_FTSR] >> line & 1u;
}

/* The level on pin `line` of `port` has changed. */
static void exti_edge(struct native *n, uint32_t port, uint32_t line, bool rising)
{
	uint32_t *const w = device_words(n, n->devices[EXTI][0]);

	if ((w[rising ? EXTI_RTSR : EXTI_FTSR] >> line & 1u) == 0u || !n->s.clocked[n->devices[SYSCFG][0]])
		return;
	/* EXTICR1 to 4 are words 2 to 5, four bits a line. */
	if ((device_words(n, n->devices[SYSCFG][0])[2u + line / 4u] >> 4u * (line % 4u) & 15u) != port)
		return;
	w[EXTI_PR] |= 1u << line;
	exti_update(n);
}

void exti_write(struct native *n, uint32_t word, uint32_t value)
{
	uint32_t *const w = device_words(n, n->devices[EXTI][0]);

	if (word == EXTI_PR) {
		w[EXTI_PR] &= ~value;
		w[EXTI_SWIER] &= ~value;
	} else {
		const uint32_t changed = device_keep(n, n->devices[EXTI][0], word, value);

		if (word == EXTI_SWIER)
			w[EXTI_PR] |= changed & w[EXTI_SWIER] & w[EXTI_IMR];
	}
	exti_update(n);
}

/* ---- GPIO ---- */

enum { CS_PORT = 2 }; /* of both chips on SPI */
static const uint8_t cs_pins[SPIS] = {2, 1};

static bool pins_level(const struct native *n, uint32_t port, uint32_t pin)
{
	const uint32_t *const w = n->s.words[n->devices[PORT][port]];
	const bool odr = (w[ODR] >> pin & 1u) != 0u;

	if ((w[MODER] >> 2u * pin & 3u) == 1u && !((w[OTYPER] >> pin & 1u) != 0u && odr))
		return odr;
	if (n->s.driven[port] >> pin & 1u)
		return n->s.high[port] >> pin & 1u;
	return (w[PUPDR] >> 2u * pin & 3u) == 1u;
}

void pins_tell(struct native *n, uint32_t port)
{
	for (uint32_t i = 0; port == CS_PORT && i < SPIS; ++i) {
		struct spi *const spi = &n->s.spis[i];
		const bool selected = !pins_level(n, CS_PORT, cs_pins[i]);

		spi->transaction += selected != spi->selected;
		spi->selected = selected;
	}
	for (uint32_t pin = 0; n->watched[port] >> pin != 0u; ++pin) {
		if ((n->watched[port] >> pin & 1u) == 0u)
			continue;
		const bool level = pins_level(n, port, pin);

		if (level != (n->s.told[port] >> pin & 1u)) {
			n->s.told[port] ^= (uint16_t)(1u << pin);
			n->callbacks.pin(n->devices[PORT][port], pin, level);
		}
	}
}

uint32_t pins_read(struct native *n, uint32_t device, uint32_t word)
{
	const uint32_t port = n->numbers[device];
	uint32_t value = 0;

	if (word != IDR)
		return device_words(n, device)[word];
	for (uint32_t pin = 0; pin < 16u; ++pin)
		if ((device_words(n, device)[MODER] >> 2u * pin & 3u) != 3u)
			value |= (uint32_t)pins_level(n, port, pin) << pin;
	return value;
}

void pins_write(struct native *n, uint32_t device, uint32_t word, uint32_t value)
{
	uint32_t *const w = device_words(n, device);

	if (word == BSRR) /* setting wins where both are asked for (RM0431 6.4.7) */
		w[ODR] = (w[ODR] & ~(value >> 16)) | (value & 0xFFFFu);
	else if (device_keep(n, device, word, value) != 0u && word != ODR)
		++n->s.epoch;
	pins_tell(n, n->numbers[device]);
}

void native_drive(struct native *n, uint32_t port, uint32_t pin, bool level)
{
	const uint16_t bit = (uint16_t)(1u << pin);

	if ((n->s.driven[port] & bit) != 0u && ((n->s.high[port] & bit) != 0u) == level)
		return;
	n->s.driven[port] |= bit;
	n->s.high[port] = (uint16_t)(level ? n->s.high[port] | bit : n->s.high[port] & ~bit);
	exti_edge(n, port, pin, level);
	pins_tell(n, port);
}

/* The board lets a pin rise; where it was high still, it falls first. */
void pins_pulse(struct native *n, uint32_t port, uint32_t pin)
{
	native_drive(n, port, pin, false);
	native_drive(n, port, pin, true);
}

void native_watch(struct native *n, uint32_t port, uint32_t pin)
{
	n->watched[port] |= (uint16_t)(1u << pin);
	n->s.told[port] = (uint16_t)((n->s.told[port] & ~(1u << pin)) | (uint32_t)pins_level(n, port, pin) << pin);
}
