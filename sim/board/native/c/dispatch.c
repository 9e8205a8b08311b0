/* The native peripherals as a whole: the engine's accesses and alarms go to them or to Python; what Python sets up. */
#include <stdlib.h>

#include "dma.h"
#include "gyro_chip.h"
#include "pins.h"
#include "spi.h"
#include "timer.h"
#include "watchdog.h"

/* ---- the engine's callbacks ---- */

static uint32_t dispatch_read(void *user, uint32_t window, uint32_t offset, uint32_t size)
{
	struct native *const h = user;
	const int16_t device = h->device_of[window];

	if (device < 0)
		return h->python.read(h->python.user, window, offset, size);
	const uint32_t word = offset >> 2;
	const struct rule *const rule = &h->rules[device][word];

	h->failed = false;
	if (!rule->known || !h->s.clocked[device] || (rule->sizes & size) == 0u || !rule->readable) {
		h->callbacks.reject((uint32_t)device, offset, size, 0, false);
		return 0;
	}
	++h->s.reads[device][word];
	uint32_t value;

	switch (h->kinds[device]) {
	case PORT: value = pins_read(h, (uint32_t)device, word); break;
	case DMA: value = dma_read(h, (uint32_t)device, word); break;
	case SPI: return spi_read(h, word, size);
	case TIMER: value = timer_read(h, (uint32_t)device, word); break;
	default: value = device_words(h, (uint32_t)device)[word]; break;
	}
	return size == 4u ? value : value >> 8u * (offset & 3u) & ((1u << 8u * size) - 1u);
}

static void dispatch_write(void *user, uint32_t window, uint32_t offset, uint32_t size, uint32_t value)
{
	struct native *const h = user;
	const int16_t device = h->device_of[window];

	if (device < 0) {
		if (!watchdog_feed(h, window, offset, size, value))
			h->python.write(h->python.user, window, offset, size, value);
		return;
	}
	const uint32_t word = offset >> 2;
	const struct rule *const rule = &h->rules[device][word];
	const bool data = h->kinds[device] == SPI && word == SPI_DR;

	h->failed = false;
	if (!rule->known || !h->s.clocked[device] || (rule->sizes & size) == 0u || !rule->writeable) {
		h->callbacks.reject((uint32_t)device, offset, size, value, true);
		return;
	}
	if (size != 4u && !data) {
		const uint32_t shift = 8u * (offset & 3u), mask = ((1u << 8u * size) - 1u) << shift;

		value = ((rule->readable ? device_words(h, (uint32_t)device)[word] : 0u) & ~mask) | (value << shift & mask);
	}
	if (!data && ((value ^ rule->reset) & rule->fixed) != 0u) {
		h->callbacks.reject((uint32_t)device, offset & ~3u, 4, value, true);
		return;
	}
	++h->s.writes[device][word];
	switch (h->kinds[device]) {
	case PORT: pins_write(h, (uint32_t)device, word, value); break;
	case EXTI: exti_write(h, word, value); break;
	case DMA: dma_write(h, (uint32_t)device, word, value); break;
	case SPI: spi_write(h, word, size, value); break;
	case TIMER: timer_write(h, (uint32_t)device, word, value); break;
	default: device_keep(h, (uint32_t)device, word, value); break;
	}
}

static void dispatch_alarm(void *user, uint32_t alarm)
{
	struct native *const h = user;

	h->failed = false;
	if (alarm == h->alarms[h->spi]) {
		spi_sync(h);
		spi_start(h);
		return;
	}
	if (alarm == h->gyro_alarm) {
		gyro_sample(h);
		return;
	}
	if (alarm == h->gyro_fall_alarm) {
		gyro_fall(h);
		return;
	}
	for (uint32_t t = 0; t < TIMERS; ++t) {
		if (alarm == h->alarms[h->timer_devices[t]]) {
			timer_sync(h, t);
			timer_plan(h, t);
			return;
		}
	}
	h->python.alarm(h->python.user, alarm);
}

static void dispatch_flash(void *user, uint32_t address, uint32_t size, uint32_t value)
{
	struct native *const h = user;

	h->python.flash(h->python.user, address, size, value);
}

static void dispatch_sleep(void *user)
{
	struct native *const h = user;

	h->failed = false;
	dma_sleep(h);
}

/* ---- for Python ---- */

struct native *native_new(struct engine *e, const struct callbacks *python, const struct native_callbacks *callbacks)
{
	struct native *const h = calloc(1, sizeof *h);

	if (h == NULL)
		return NULL;
	h->e = e;
	h->python = *python;
	h->callbacks = *callbacks;
	h->s.begun = NEVER;
	h->gyro_alarm = h->gyro_fall_alarm = UINT32_MAX;
	h->watchdog_window = UINT32_MAX;
	h->s.epoch = 1;
	h->s.apb2 = h->s.timer_clock[0] = h->s.timer_clock[1] = 16000000;
	for (uint32_t i = 0; i < WINDOWS; ++i)
		h->device_of[i] = -1;
	for (uint32_t i = 0; i < PYTHON_SOURCE; ++i)
		h->drivers[i] = i < TIMER_SOURCE ? &spi_driver : &timer_driver;
	for (uint32_t i = 0; i < SOURCES; ++i) {
		h->s.stream_of[i] = -1;
		h->s.due[i] = NEVER;
		h->s.source_alarms[i] = UINT32_MAX;
	}
	for (uint32_t i = 0; i < 2u * STREAMS; ++i)
		for (uint32_t k = 0; k < SHARED; ++k)
			h->s.streams[i / STREAMS][i % STREAMS].sources[k] = -1;
	const struct callbacks own = {
		dispatch_read, dispatch_write, dispatch_alarm, dispatch_flash, dispatch_sleep, h,
	};

	engine_callbacks(e, &own);
	return h;
}

void native_free(struct native *h)
{
	free(h);
}

uint32_t native_device(struct native *h, uint32_t kind, uint32_t number, uint32_t base, uint32_t alarm, bool advanced)
{
	const uint32_t device = h->device_count++;

	h->kinds[device] = (uint8_t)kind;
	h->numbers[device] = (uint8_t)number;
	h->bases[device] = base;
	h->alarms[device] = alarm;
	switch (kind) {
	case PORT: h->ports[number] = device; break;
	case SYSCFG: h->syscfg = device; break;
	case EXTI: h->exti = device; break;
	case DMA: h->controllers[number] = device; break;
	case SPI: h->spi = device; break;
	default: h->timer_devices[number] = device; h->advanced[number] = advanced; break;
	}
	return device;
}

void native_place(struct native *h, uint32_t device, uint32_t window)
{
	h->device_of[window] = (int16_t)device;
}

void native_rule(struct native *h, uint32_t device, uint32_t word, const struct rule *rule)
{
	h->rules[device][word] = *rule;
	h->s.words[device][word] = rule->reset;
}

void native_irq(struct native *h, uint32_t device, uint32_t place, uint32_t number)
{
	h->irqs[device][place] = number;
}

bool native_is_clocked(const struct native *h, uint32_t device)
{
	return h->s.clocked[device];
}

void native_clock(struct native *h, uint32_t device, bool on)
{
	h->s.epoch += h->s.clocked[device] != on;
	h->s.clocked[device] = on;
}

void native_clocks(struct native *h, uint64_t apb2, uint64_t timer1, uint64_t timer2)
{
	h->failed = false;
	spi_sync(h);
	h->s.apb2 = apb2;
	spi_plan(h);
	timer_clocks(h, timer1, timer2);
}

void native_reset(struct native *h, uint32_t device)
{
	const uint32_t number = h->numbers[device];

	for (uint32_t word = 0; word < WORDS; ++word)
		h->s.words[device][word] = h->rules[device][word].reset;
	++h->s.epoch;
	switch (h->kinds[device]) {
	case PORT: pins_tell(h, number); break;
	case EXTI: exti_update(h); break;
	case DMA: dma_reset(h, number); break;
	case SPI: spi_reset(h); break;
	case TIMER: timer_reset(h, number); break;
	default: break;
	}
}

uint32_t *native_words(struct native *h, uint32_t device)
{
	return h->s.words[device];
}

uint64_t native_touched(const struct native *h, uint32_t device, uint32_t word, bool writes)
{
	return writes ? h->s.writes[device][word] : h->s.reads[device][word];
}

void *native_state(struct native *h)
{
	return &h->s;
}

uint32_t native_state_bytes(void)
{
	return sizeof(struct native_state);
}
