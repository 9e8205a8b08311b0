/* The busy peripherals between the engine and Python: accesses, alarms, and what Python sets and asks. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "native.h"

enum { WATCHDOG_FEED = 0xAAAA };

_Thread_local struct hot *hot_current;

/* ---- the engine's callbacks ---- */

uint32_t hot_read(uint32_t window, uint32_t offset, uint32_t size)
{
	struct hot *const h = hot_current;
	const int16_t device = h->device_of[window];

	if (device < 0)
		return h->on_read(window, offset, size);
	const uint32_t slot = offset >> 2;
	const struct rule *const rule = &h->rules[device][slot];

	h->failed = false;
	if (!rule->known || !h->s.clocked[device] || (rule->sizes & size) == 0u || !rule->readable) {
		h->refuse(window, offset, size, 0, false);
		return 0;
	}
	++h->s.reads[device][slot];
	uint32_t value;

	switch (h->kinds[device]) {
	case PORT: value = port_read(h, (uint32_t)device, slot); break;
	case DMA: value = dma_read(h, (uint32_t)device, slot); break;
	case SPI: return spi_read(h, slot, size);
	case TIMER: value = timer_read(h, (uint32_t)device, slot); break;
	default: value = words(h, (uint32_t)device)[slot]; break;
	}
	return size == 4u ? value : value >> 8u * (offset & 3u) & ((1u << 8u * size) - 1u);
}

/* sim/board/peripherals/iwdg.py says why; whatever is no plain feed is Python's. */
static bool feeds_watchdog(struct hot *h, uint32_t window, uint32_t offset, uint32_t size, uint32_t value)
{
	struct watchdog *const w = &h->s.watchdog;

	if (window != h->watchdog_window || offset != h->watchdog_offset || size != 4u || value != WATCHDOG_FEED ||
	    w->period == 0u)
		return false;
	const uint64_t due = engine_due(h->e, h->watchdog_alarm), cycle = now(h);

	if (due != NEVER && due >= cycle && due - cycle < w->closest)
		w->closest = due - cycle;
	++w->feeds;
	++w->writes;
	engine_set_alarm(h->e, h->watchdog_alarm, cycle + w->period);
	return true;
}

void hot_write(uint32_t window, uint32_t offset, uint32_t size, uint32_t value)
{
	struct hot *const h = hot_current;
	const int16_t device = h->device_of[window];

	if (device < 0) {
		if (!feeds_watchdog(h, window, offset, size, value))
			h->on_write(window, offset, size, value);
		return;
	}
	const uint32_t slot = offset >> 2;
	const struct rule *const rule = &h->rules[device][slot];
	const bool data = h->kinds[device] == SPI && slot == SPI_DR;

	h->failed = false;
	if (!rule->known || !h->s.clocked[device] || (rule->sizes & size) == 0u || !rule->writeable) {
		h->refuse(window, offset, size, value, true);
		return;
	}
	if (size != 4u && !data) {
		const uint32_t shift = 8u * (offset & 3u), mask = ((1u << 8u * size) - 1u) << shift;

		value = ((rule->readable ? words(h, (uint32_t)device)[slot] : 0u) & ~mask) | (value << shift & mask);
	}
	if (!data && ((value ^ rule->reset) & rule->fixed) != 0u) {
		h->refuse(window, offset & ~3u, 4, value, true);
		return;
	}
	++h->s.writes[device][slot];
	switch (h->kinds[device]) {
	case PORT: port_write(h, (uint32_t)device, slot, value); break;
	case EXTI: exti_write(h, slot, value); break;
	case DMA: dma_write(h, (uint32_t)device, slot, value); break;
	case SPI: spi_write(h, slot, size, value); break;
	case TIMER: timer_write(h, (uint32_t)device, slot, value); break;
	default: keep(h, (uint32_t)device, slot, value); break;
	}
}

void hot_alarm(uint32_t alarm)
{
	struct hot *const h = hot_current;

	h->failed = false;
	if (alarm == h->alarms[h->spi]) {
		spi_sync(h);
		spi_start(h);
		return;
	}
	if (alarm == h->gyro_alarm && h->gyro_samples) {
		gyro_sample(h);
		return;
	}
	for (uint32_t t = 0; t < TIMERS; ++t) {
		if (alarm == h->alarms[h->timer_devices[t]]) {
			timer_sync(h, t);
			timer_plan(h, t);
			return;
		}
	}
	h->on_alarm(alarm);
}

/* ---- for Python ---- */

struct hot *hot_new(struct engine *e, read_function on_read, write_function on_write, alarm_function on_alarm,
		    refuse_function refuse, judge_function judge, source_function source, exchange_function exchange,
		    pulses_function pulses, pin_function pin)
{
	struct hot *const h = calloc(1, sizeof *h);

	if (h == NULL)
		return NULL;
	h->e = e;
	h->on_read = on_read, h->on_write = on_write, h->on_alarm = on_alarm;
	h->refuse = refuse, h->judge = judge, h->source = source;
	h->exchange = exchange, h->pulses = pulses, h->pin = pin;
	h->s.begun = NEVER;
	h->watchdog_window = UINT32_MAX;
	h->s.epoch = 1;
	h->s.apb2 = h->s.timer_clock[0] = h->s.timer_clock[1] = 16000000;
	for (uint32_t i = 0; i < WINDOWS; ++i)
		h->device_of[i] = -1;
	for (uint32_t i = 0; i < SOURCES; ++i) {
		h->s.stream_of[i] = -1;
		h->s.due[i] = NEVER;
		h->s.source_alarms[i] = UINT32_MAX;
	}
	for (uint32_t i = 0; i < 2u * STREAMS; ++i)
		for (uint32_t k = 0; k < SHARED; ++k)
			h->s.streams[i / STREAMS][i % STREAMS].sources[k] = -1;
	return h;
}

void hot_free(struct hot *h)
{
	if (hot_current == h)
		hot_current = NULL;
	free(h);
}

/* The callbacks that follow are of the engine that `h` belongs to. */
void hot_select(struct hot *h)
{
	hot_current = h;
}

/* Device `device` of `kind`, number `number` among its kind, answers in `window` at `base`. */
void hot_device(struct hot *h, uint32_t device, uint32_t kind, uint32_t number, uint32_t window, uint32_t base,
		uint32_t alarm, bool advanced)
{
	h->kinds[device] = (uint8_t)kind;
	h->numbers[device] = (uint8_t)number;
	h->bases[device] = base;
	h->alarms[device] = alarm;
	h->device_of[window] = (int16_t)device;
	switch (kind) {
	case PORT: h->ports[number] = device; break;
	case SYSCFG: h->syscfg = device; break;
	case EXTI: h->exti = device; break;
	case DMA: h->controllers[number] = device; break;
	case SPI: h->spi = device; break;
	default: h->timer_devices[number] = device; h->advanced[number] = advanced; break;
	}
}

void hot_rule(struct hot *h, uint32_t device, uint32_t slot, const struct rule *rule)
{
	h->rules[device][slot] = *rule;
	h->s.words[device][slot] = rule->reset;
}

/* The ESC of motor `motor` (from 0) is on that channel. */
struct esc *hot_esc(struct hot *h, uint32_t motor, uint32_t t, uint32_t channel)
{
	struct esc *const esc = &h->s.timers[t].escs[channel - 1u];

	h->motors[motor] = esc;
	return esc;
}

/* What the ESCs of the first motors obey: their last values, 0 before any and after `silent` cycles without one. */
void hot_obeyed(const struct hot *h, uint32_t count, uint64_t silent, uint16_t *values)
{
	const uint64_t cycle = now(h);

	for (uint32_t i = 0; i < count; ++i) {
		const struct esc *const esc = h->motors[i];
		const bool hears = esc->last != UINT32_MAX && (cycle <= esc->last_cycle || cycle - esc->last_cycle <= silent);

		values[i] = hears ? (uint16_t)(esc->last >> 1) : 0u;
	}
}

/* Where the watchdog's key register lies, and its alarm. */
struct watchdog *hot_watchdog(struct hot *h, uint32_t window, uint32_t offset, uint32_t alarm)
{
	h->watchdog_window = window;
	h->watchdog_offset = offset;
	h->watchdog_alarm = alarm;
	return &h->s.watchdog;
}

void hot_listen(struct hot *h, bool listening)
{
	h->listening = listening;
}

/* Hands over the frames that have come; returns how many there are. They are gone with the next frame. */
uint32_t hot_frames(struct hot *h, const struct frame **frames)
{
	const uint32_t count = h->s.frame_count;

	*frames = h->s.frames;
	h->s.frame_count = 0;
	return count;
}

void hot_lazy(struct hot *h, uint32_t source)
{
	h->lazy |= UINT64_C(1) << source;
}

void hot_irq(struct hot *h, uint32_t device, uint32_t place, uint32_t number)
{
	h->irqs[device][place] = number;
}

void hot_clock(struct hot *h, uint32_t device, bool on)
{
	h->s.epoch += h->s.clocked[device] != on;
	h->s.clocked[device] = on;
}

void hot_touch_epoch(struct hot *h)
{
	++h->s.epoch;
}

void hot_clocks(struct hot *h, uint64_t apb2, uint64_t timer1, uint64_t timer2)
{
	uint32_t counts[TIMERS];

	h->failed = false;
	spi_sync(h);
	for (uint32_t t = 0; t < TIMERS; ++t) {
		timer_sync(h, t);
		counts[t] = timer_count(h, t);
	}
	h->s.apb2 = apb2;
	h->s.timer_clock[0] = timer1;
	h->s.timer_clock[1] = timer2;
	spi_plan(h);
	for (uint32_t t = 0; t < TIMERS; ++t) {
		h->s.timers[t].anchor = now(h) - timer_cycles(h, t, counts[t]);
		timer_plan(h, t);
	}
}

/* As after a reset of the chip or by the peripheral's bit in RCC. */
void hot_reset(struct hot *h, uint32_t device)
{
	const uint32_t number = h->numbers[device];

	for (uint32_t slot = 0; slot < SLOTS; ++slot)
		h->s.words[device][slot] = h->rules[device][slot].reset;
	++h->s.epoch;
	switch (h->kinds[device]) {
	case PORT:
		tell_pins(h, number);
		break;
	case EXTI:
		exti_update(h);
		break;
	case DMA:
		for (uint32_t i = 0; i < STREAMS; ++i) {
			stream_unlink(h, number, i);
			h->s.streams[number][i].total = h->s.streams[number][i].moved = 0;
			engine_irq(h->e, h->irqs[device][i], false);
		}
		break;
	case SPI:
		h->s.sending_count = h->s.received_count = h->s.last = h->s.overrun = 0;
		h->s.begun = NEVER;
		engine_set_alarm(h->e, h->alarms[device], NEVER);
		engine_irq(h->e, h->irqs[device][0], false);
		break;
	case TIMER:
		memset(&h->s.timers[number], 0, offsetof(struct timer, escs)); /* ESCs live on */
		timer_load(h, number);
		engine_set_alarm(h->e, h->alarms[device], NEVER);
		engine_irq(h->e, h->irqs[device][0], false);
		break;
	default:
		break;
	}
}

uint32_t *hot_words(struct hot *h, uint32_t device)
{
	return h->s.words[device];
}

uint64_t hot_touched(const struct hot *h, uint32_t device, uint32_t slot, bool writes)
{
	return writes ? h->s.writes[device][slot] : h->s.reads[device][slot];
}

struct hot_state *hot_state(struct hot *h)
{
	return &h->s;
}

uint32_t hot_state_bytes(void)
{
	return sizeof(struct hot_state);
}
