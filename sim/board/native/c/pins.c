/* GPIO and EXTI (RM0431 6 and 11): levels of pins, edges, pending bits and interrupts. */
#include "pins.h"

/* ---- EXTI ---- */

enum { EXTI_IMR = 0, EXTI_RTSR = 2, EXTI_FTSR = 3, EXTI_SWIER = 4, EXTI_PR = 5 };

void exti_update(struct native *h)
{
	static const uint32_t lines[STREAMS] = {1u << 0, 1u << 1, 1u << 2, 1u << 3, 1u << 4, 0x03E0u, 0xFC00u, 1u << 16};
	const uint32_t *const w = device_words(h, h->exti);
	const uint32_t pending = w[EXTI_PR] & w[EXTI_IMR], changed = pending ^ h->s.exti_asserted;

	h->s.exti_asserted = pending;
	for (uint32_t i = 0; changed != 0u && i < STREAMS; ++i)
		if (changed & lines[i])
			engine_irq(h->e, h->irqs[h->exti][i], (pending & lines[i]) != 0u);
}

bool exti_watches_fall(const struct native *h, uint32_t line)
{
	return h->s.words[h->exti][EXTI_FTSR] >> line & 1u;
}

/* The level on pin `line` of `port` has changed. */
static void exti_edge(struct native *h, uint32_t port, uint32_t line, bool rising)
{
	uint32_t *const w = device_words(h, h->exti);

	if ((w[rising ? EXTI_RTSR : EXTI_FTSR] >> line & 1u) == 0u || !h->s.clocked[h->syscfg])
		return;
	/* EXTICR1 to 4 are words 2 to 5, four bits a line. */
	if ((device_words(h, h->syscfg)[2u + line / 4u] >> 4u * (line % 4u) & 15u) != port)
		return;
	w[EXTI_PR] |= 1u << line;
	exti_update(h);
}

void exti_write(struct native *h, uint32_t word, uint32_t value)
{
	uint32_t *const w = device_words(h, h->exti);

	if (word == EXTI_PR) {
		w[EXTI_PR] &= ~value;
		w[EXTI_SWIER] &= ~value;
	} else {
		const uint32_t changed = device_keep(h, h->exti, word, value);

		if (word == EXTI_SWIER)
			w[EXTI_PR] |= changed & w[EXTI_SWIER] & w[EXTI_IMR];
	}
	exti_update(h);
}

/* ---- GPIO ---- */

enum { CS_PORT = 2, CS_PIN = 2 };

static bool pins_level(const struct native *h, uint32_t port, uint32_t pin)
{
	const uint32_t *const w = h->s.words[h->ports[port]];
	const bool odr = (w[ODR] >> pin & 1u) != 0u;

	if ((w[MODER] >> 2u * pin & 3u) == 1u && !((w[OTYPER] >> pin & 1u) != 0u && odr))
		return odr;
	if (h->s.driven[port] >> pin & 1u)
		return h->s.high[port] >> pin & 1u;
	return (w[PUPDR] >> 2u * pin & 3u) == 1u;
}

void pins_tell(struct native *h, uint32_t port)
{
	if (port == CS_PORT) {
		const bool selected = !pins_level(h, CS_PORT, CS_PIN);

		h->s.transaction += selected != h->s.selected;
		h->s.selected = selected;
	}
	for (uint32_t pin = 0; h->watched[port] >> pin != 0u; ++pin) {
		if ((h->watched[port] >> pin & 1u) == 0u)
			continue;
		const bool level = pins_level(h, port, pin);

		if (level != (h->s.told[port] >> pin & 1u)) {
			h->s.told[port] ^= (uint16_t)(1u << pin);
			h->callbacks.pin(h->ports[port], pin, level);
		}
	}
}

uint32_t pins_read(struct native *h, uint32_t device, uint32_t word)
{
	const uint32_t port = h->numbers[device];
	uint32_t value = 0;

	if (word != IDR)
		return device_words(h, device)[word];
	for (uint32_t pin = 0; pin < 16u; ++pin)
		if ((device_words(h, device)[MODER] >> 2u * pin & 3u) != 3u)
			value |= (uint32_t)pins_level(h, port, pin) << pin;
	return value;
}

void pins_write(struct native *h, uint32_t device, uint32_t word, uint32_t value)
{
	uint32_t *const w = device_words(h, device);

	if (word == BSRR) /* setting wins where both are asked for (RM0431 6.4.7) */
		w[ODR] = (w[ODR] & ~(value >> 16)) | (value & 0xFFFFu);
	else if (device_keep(h, device, word, value) != 0u && word != ODR)
		++h->s.epoch;
	pins_tell(h, h->numbers[device]);
}

void native_drive(struct native *h, uint32_t port, uint32_t pin, bool level)
{
	const uint16_t bit = (uint16_t)(1u << pin);

	if ((h->s.driven[port] & bit) != 0u && ((h->s.high[port] & bit) != 0u) == level)
		return;
	h->s.driven[port] |= bit;
	h->s.high[port] = (uint16_t)(level ? h->s.high[port] | bit : h->s.high[port] & ~bit);
	exti_edge(h, port, pin, level);
	pins_tell(h, port);
}

/* The board lets a pin rise; where it was high still, it falls first. */
void pins_pulse(struct native *h, uint32_t port, uint32_t pin)
{
	native_drive(h, port, pin, false);
	native_drive(h, port, pin, true);
}

void native_watch(struct native *h, uint32_t port, uint32_t pin)
{
	h->watched[port] |= (uint16_t)(1u << pin);
	h->s.told[port] = (uint16_t)((h->s.told[port] & ~(1u << pin)) | (uint32_t)pins_level(h, port, pin) << pin);
}
