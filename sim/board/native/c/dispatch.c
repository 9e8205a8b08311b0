/* The native peripherals as a whole: the engine's accesses and alarms go to them or to Python; what Python sets up. */
#include <stdlib.h>
#include <string.h>

#include "peripherals.h"

/* ---- the engine's callbacks ---- */

static uint32_t dispatch_read(void *user, uint32_t window, uint32_t offset, uint32_t size)
{
	struct native *const n = user;
	const int16_t device = n->device_of[window];

	if (device < 0)
		return n->python.read(n->python.user, window, offset, size);
	const uint32_t word = offset >> 2;
	const struct rule *const rule = &n->rules[device][word];

	n->failed = false;
	if (!rule->known || !n->s.clocked[device] || (rule->sizes & size) == 0u || !rule->readable) {
		n->callbacks.reject((uint32_t)device, offset, size, 0, false);
		return 0;
	}
	++n->s.reads[device][word];
	uint32_t value;

	switch (n->kinds[device]) {
	case PORT: value = pins_read(n, (uint32_t)device, word); break;
	case DMA: value = dma_read(n, (uint32_t)device, word); break;
	case SPI: return spi_read(n, n->numbers[device], word, size);
	case TIMER: value = timer_read(n, (uint32_t)device, word); break;
	default: value = device_words(n, (uint32_t)device)[word]; break;
	}
	return size == 4u ? value : value >> 8u * (offset & 3u) & ((1u << 8u * size) - 1u);
}

static void dispatch_write(void *user, uint32_t window, uint32_t offset, uint32_t size, uint32_t value)
{
	struct native *const n = user;
	const int16_t device = n->device_of[window];

	if (device < 0) {
		if (!watchdog_feed(n, window, offset, size, value))
			n->python.write(n->python.user, window, offset, size, value);
		return;
	}
	const uint32_t word = offset >> 2;
	const struct rule *const rule = &n->rules[device][word];
	const bool data = n->kinds[device] == SPI && word == SPI_DR;

	n->failed = false;
	if (!rule->known || !n->s.clocked[device] || (rule->sizes & size) == 0u || !rule->writeable) {
		n->callbacks.reject((uint32_t)device, offset, size, value, true);
		return;
	}
	if (size != 4u && !data) {
		const uint32_t shift = 8u * (offset & 3u), mask = ((1u << 8u * size) - 1u) << shift;

		value = ((rule->readable ? device_words(n, (uint32_t)device)[word] : 0u) & ~mask) | (value << shift & mask);
	}
	if (!data && ((value ^ rule->reset) & rule->fixed) != 0u) {
		n->callbacks.reject((uint32_t)device, offset & ~3u, 4, value, true);
		return;
	}
	++n->s.writes[device][word];
	switch (n->kinds[device]) {
	case PORT: pins_write(n, (uint32_t)device, word, value); break;
	case EXTI: exti_write(n, word, value); break;
	case DMA: dma_write(n, (uint32_t)device, word, value); break;
	case SPI: spi_write(n, n->numbers[device], word, size, value); break;
	case TIMER: timer_write(n, (uint32_t)device, word, value); break;
	default: device_keep(n, (uint32_t)device, word, value); break;
	}
}

static void dispatch_alarm(void *user, uint32_t alarm)
{
	struct native *const n = user;

	n->failed = false;
	for (uint32_t i = 0; i < SPIS; ++i) {
		if (alarm == n->alarms[n->devices[SPI][i]]) {
			spi_sync(n, i);
			spi_start(n, i);
			return;
		}
	}
	if (alarm == n->gyro_alarm) {
		gyro_sample(n);
		return;
	}
	if (alarm == n->gyro_fall_alarm) {
		gyro_fall(n);
		return;
	}
	for (uint32_t t = 0; t < TIMERS; ++t) {
		if (alarm == n->alarms[n->devices[TIMER][t]]) {
			timer_sync(n, t);
			timer_plan(n, t);
			return;
		}
	}
	n->python.alarm(n->python.user, alarm);
}

static void dispatch_sleep(void *user)
{
	struct native *const n = user;

	n->failed = false;
	dma_sleep(n);
}

/* ---- for Python ---- */

struct native *native_new(struct engine *e, const struct callbacks *python, const struct native_callbacks *callbacks)
{
	struct native *const n = calloc(1, sizeof *n);

	if (n == NULL)
		return NULL;
	n->e = e;
	n->python = *python;
	n->callbacks = *callbacks;
	for (uint32_t i = 0; i < SPIS; ++i) {
		n->s.spis[i].begun = NEVER;
		n->s.spis[i].clock = 16000000;
	}
	for (uint32_t i = 0; i < SPIS; ++i)
		n->miso[i].port = NO_PORT;
	n->ready.port = NO_PORT;
	n->gyro_chip = n->log_chip = CHIPS;
	n->gyro_alarm = n->gyro_fall_alarm = UINT32_MAX;
	n->watchdog_window = UINT32_MAX;
	n->s.epoch = 1;
	n->s.timer_clock[0] = n->s.timer_clock[1] = 16000000;
	for (uint32_t i = 0; i < WINDOWS; ++i)
		n->device_of[i] = -1;
	for (uint32_t i = 0; i < PYTHON_SOURCE; ++i)
		n->drivers[i] = i < TIMER_SOURCE ? &spi_driver : &timer_driver;
	for (uint32_t i = 0; i < SOURCES; ++i) {
		n->s.stream_of[i] = -1;
		n->s.due[i] = NEVER;
		n->s.source_alarms[i] = UINT32_MAX;
	}
	for (uint32_t i = 0; i < 2u * STREAMS; ++i)
		for (uint32_t k = 0; k < SHARED; ++k)
			n->s.streams[i / STREAMS][i % STREAMS].sources[k] = -1;
	const struct callbacks own = { /* Python's do not look at `user` */
		dispatch_read, dispatch_write, dispatch_alarm, python->flash, dispatch_sleep, python->rom, n,
	};

	engine_callbacks(e, &own);
	return n;
}

void native_free(struct native *n)
{
	free(n);
}

uint32_t native_device(struct native *n, uint32_t kind, uint32_t number, uint32_t base, uint32_t alarm, bool advanced)
{
	const uint32_t device = n->device_count++;

	n->kinds[device] = (uint8_t)kind;
	n->numbers[device] = (uint8_t)number;
	n->bases[device] = base;
	n->alarms[device] = alarm;
	n->devices[kind][number] = device;
	if (kind == TIMER)
		n->advanced[number] = advanced;
	return device;
}

void native_place(struct native *n, uint32_t device, uint32_t window)
{
	n->device_of[window] = (int16_t)device;
}

void native_rule(struct native *n, uint32_t device, uint32_t word, const struct rule *rule)
{
	n->rules[device][word] = *rule;
	n->s.words[device][word] = rule->reset;
}

void native_irq(struct native *n, uint32_t device, uint32_t place, uint32_t number)
{
	n->irqs[device][place] = number;
}

bool native_is_clocked(const struct native *n, uint32_t device)
{
	return n->s.clocked[device];
}

void native_clock(struct native *n, uint32_t device, bool on)
{
	n->s.epoch += n->s.clocked[device] != on;
	n->s.clocked[device] = on;
}

void native_clocks(struct native *n, uint64_t apb1, uint64_t apb2, uint64_t timer1, uint64_t timer2)
{
	n->failed = false;
	for (uint32_t i = 0; i < SPIS; ++i) {
		spi_sync(n, i);
		n->s.spis[i].clock = i == 0u ? apb2 : apb1;
		spi_plan(n, i);
	}
	timer_clocks(n, timer1, timer2);
}

void native_card_sync(struct native *n)
{
	if (n->log_chip < CHIPS && n->s.spis[n->places[n->log_chip].spi].begun != NEVER)
		spi_sync(n, n->places[n->log_chip].spi);
}

void native_reset(struct native *n, uint32_t device)
{
	const uint32_t number = n->numbers[device];

	for (uint32_t word = 0; word < WORDS; ++word)
		n->s.words[device][word] = n->rules[device][word].reset;
	++n->s.epoch;
	switch (n->kinds[device]) {
	case PORT: pins_tell(n, number); break;
	case EXTI: exti_update(n); break;
	case DMA: dma_reset(n, number); break;
	case SPI: spi_reset(n, number); break;
	case TIMER: timer_reset(n, number); break;
	default: break;
	}
}

uint32_t *native_words(struct native *n, uint32_t device)
{
	return n->s.words[device];
}

uint64_t native_touched(const struct native *n, uint32_t device, uint32_t word, bool writes)
{
	return writes ? n->s.writes[device][word] : n->s.reads[device][word];
}

void *native_state(struct native *n)
{
	return &n->s;
}

uint32_t native_state_bytes(void)
{
	return sizeof(struct native_state);
}
