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

enum { OUTPUT = 1, ANALOG = 3 }; /* MODER; below OUTPUT it is an input */

static uint32_t pins_mode(const struct native *n, uint32_t port, uint32_t pin)
{
	return n->s.words[n->devices[PORT][port]][MODER] >> 2u * pin & 3u;
}

/* Does the program drive the pin? Open drain only pulls low. */
static bool pins_driven(const struct native *n, uint32_t port, uint32_t pin)
{
	const uint32_t *const w = n->s.words[n->devices[PORT][port]];

	return pins_mode(n, port, pin) == OUTPUT && !((w[OTYPER] >> pin & 1u) != 0u && (w[ODR] >> pin & 1u) != 0u);
}

/* Without what an ESC drives. */
static bool pins_level(const struct native *n, uint32_t port, uint32_t pin)
{
	const uint32_t *const w = n->s.words[n->devices[PORT][port]];

	if (pins_driven(n, port, pin))
		return w[ODR] >> pin & 1u;
	if (n->s.driven[port] >> pin & 1u)
		return n->s.high[port] >> pin & 1u;
	return (w[PUPDR] >> 2u * pin & 3u) == 1u;
}

static void pins_select(struct native *n, uint32_t port)
{
	for (uint32_t i = 0; i < n->chip_count; ++i) {
		struct chip *const chip = &n->s.chips[i];
		const struct place *const place = &n->places[i];

		if (place->port != port)
			continue;
		const bool selected = !pins_level(n, port, place->pin);

		chip->transaction += selected != chip->selected;
		chip->selected = selected;
	}
}

static void pins_tell_escs(struct native *n, uint32_t port)
{
	for (uint32_t pin = 0; n->motor_pins[port] >> pin != 0u; ++pin) {
		struct esc *const esc = &n->s.escs[n->esc_of[port][pin]];

		if ((n->motor_pins[port] >> pin & 1u) == 0u)
			continue;
		esc_output(n, esc, pins_driven(n, port, pin));
		if (pins_mode(n, port, pin) <= OUTPUT) /* else it is a timer's */
			esc_edge(n, esc, native_now(n), pins_level(n, port, pin));
	}
}

void pins_tell(struct native *n, uint32_t port)
{
	if (n->chip_select[port])
		pins_select(n, port);
	pins_tell_escs(n, port);
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

/* Levels of the pins that are no motor's inputs. */
static uint32_t pins_levels(const struct native *n, uint32_t port)
{
	uint32_t levels = 0;

	for (uint32_t pin = 0; pin < PINS; ++pin)
		if (pins_mode(n, port, pin) != ANALOG && ((n->motor_pins[port] >> pin & 1u) == 0u || pins_driven(n, port, pin)))
			levels |= (uint32_t)pins_level(n, port, pin) << pin;
	return levels;
}

void pins_sample(struct native *n, uint32_t port, uint32_t word, uint32_t shift, uint32_t *items, uint32_t count,
		 uint64_t start, uint64_t step)
{
	const uint32_t levels = word == IDR ? pins_levels(n, port) : device_words(n, n->devices[PORT][port])[word];

	for (uint32_t i = 0; i < count; ++i)
		items[i] = levels;
	for (uint32_t pin = 0; word == IDR && n->motor_pins[port] >> pin != 0u; ++pin)
		if ((n->motor_pins[port] >> pin & 1u) != 0u && !pins_driven(n, port, pin) && pins_mode(n, port, pin) != ANALOG)
			esc_sample(&n->s.escs[n->esc_of[port][pin]], 1u << pin, pins_level(n, port, pin), items, count, start, step);
	for (uint32_t i = 0; shift != 0u && i < count; ++i)
		items[i] >>= shift;
}

void pins_put(struct native *n, uint32_t port, uint32_t word, uint32_t shift, const uint32_t *items, uint32_t count,
	      uint64_t start, uint64_t step)
{
	uint32_t *const w = device_words(n, n->devices[PORT][port]);
	uint32_t heard = 0;

	for (uint32_t pin = 0; n->motor_pins[port] >> pin != 0u; ++pin)
		if ((n->motor_pins[port] >> pin & 1u) != 0u && pins_mode(n, port, pin) == OUTPUT)
			heard |= 1u << pin;
	for (uint32_t i = 0; i < count; ++i) {
		const uint32_t before = w[ODR], value = items[i] << shift;

		w[ODR] = word == BSRR ? (before & ~(value >> 16)) | (value & 0xFFFFu) : value & 0xFFFFu;
		for (uint32_t changed = (before ^ w[ODR]) & heard; changed != 0u; changed &= changed - 1u) {
			const uint32_t pin = (uint32_t)__builtin_ctz(changed);

			esc_edge(n, &n->s.escs[n->esc_of[port][pin]], start + i * step, pins_level(n, port, pin));
		}
	}
	pins_tell(n, port);
}

uint32_t pins_read(struct native *n, uint32_t device, uint32_t word)
{
	const uint32_t port = n->numbers[device];
	uint32_t value;

	timers_sync_ports(n);
	if (word != IDR)
		return device_words(n, device)[word];
	pins_sample(n, port, IDR, 0, &value, 1, native_now(n), 0);
	return value;
}

/* What has passed until now passed with the chips selected as they were. */
static void pins_settle(struct native *n, uint32_t port)
{
	for (uint32_t i = 0; n->chip_select[port] && i < n->chip_count; ++i)
		if (n->places[i].port == port && n->s.spis[n->places[i].spi].begun != NEVER)
			spi_sync(n, n->places[i].spi);
}

/* Do answers to queries depend on these changed bits? A motor's pin that turns from output to input or back has no user. */
static bool pins_matters(const struct native *n, uint32_t port, uint32_t word, uint32_t before, uint32_t changed)
{
	const uint32_t after = before ^ changed;
	uint32_t others = changed;

	for (uint32_t pin = 0; word == MODER && n->motor_pins[port] >> pin != 0u; ++pin)
		if ((n->motor_pins[port] >> pin & 1u) != 0u && ((before | after) >> 2u * pin & 2u) == 0u)
			others &= ~(3u << 2u * pin);
	return others != 0u && word != ODR;
}

void pins_write(struct native *n, uint32_t device, uint32_t word, uint32_t value)
{
	uint32_t *const w = device_words(n, device);

	timers_sync_ports(n);
	pins_settle(n, n->numbers[device]);
	if (word == BSRR) { /* setting wins where both are asked for (RM0431 6.4.7) */
		w[ODR] = (w[ODR] & ~(value >> 16)) | (value & 0xFFFFu);
	} else {
		const uint32_t before = w[word], changed = device_keep(n, device, word, value);

		n->s.epoch += pins_matters(n, n->numbers[device], word, before, changed);
	}
	pins_tell(n, n->numbers[device]);
}

void native_drive(struct native *n, uint32_t port, uint32_t pin, bool level)
{
	const uint16_t bit = (uint16_t)(1u << pin);

	if ((n->s.driven[port] & bit) != 0u && ((n->s.high[port] & bit) != 0u) == level)
		return;
	timers_sync_ports(n);
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

uint32_t native_chip(struct native *n, uint32_t kind, uint32_t spi, uint32_t port, uint32_t pin)
{
	const uint32_t i = n->chip_count++;

	n->places[i] = (struct place){(uint8_t)kind, (uint8_t)spi, (uint8_t)port, (uint8_t)pin};
	n->chip_select[port] = true;
	if (kind == CHIP_GYRO)
		n->gyro_chip = i;
	if (kind == CHIP_LOG)
		n->log_chip = i;
	return i;
}

void native_miso(struct native *n, uint32_t spi, uint32_t port, uint32_t pin)
{
	n->miso[spi] = (struct pin){(uint8_t)port, (uint8_t)pin};
}
