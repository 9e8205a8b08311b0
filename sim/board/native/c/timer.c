/* TIM1 to TIM5 and TIM8 (RM0431 TIM): counters with preload, and DMA requests at updates and compares, which move items between
 * ports and memory. They drive no pins, and no request writes their own registers.
 *
 * A free-running timer costs nothing: its updates are counted when a register is read. While its requests move something,
 * an alarm marks the end of the transfer; what the pins did meanwhile is shown then, or before somebody looks. */
#include <string.h>

#include "peripherals.h"

enum { T_CR1 = 0, T_CR2 = 1, T_DIER = 3, T_SR = 4, T_EGR = 5, T_CCMR1 = 6, T_CCMR2 = 7, T_CCER = 8, T_CNT = 9,
       T_PSC = 10, T_ARR = 11, T_CCR1 = 13, T_CCR4 = 16, T_DMAR = 19 };
enum { CEN = 1u << 0, UDIS = 1u << 1, URS = 1u << 2, OPM = 1u << 3, ARPE = 1u << 7 };
enum { CCDS = 1u << 3, UIF = 1u << 0 };
enum { PORT_BYTES = 0x400 };

static uint32_t *timer_words(struct native *n, uint32_t t)
{
	return device_words(n, n->devices[TIMER][t]);
}

static uint64_t timer_cycles(const struct native *n, uint32_t t, uint64_t counts)
{
	return counts * (n->s.timers[t].psc + 1u) * TIME_HZ / n->s.timer_clock[n->advanced[t]];
}

static uint64_t timer_period(const struct native *n, uint32_t t)
{
	return timer_cycles(n, t, (uint64_t)n->s.timers[t].arr + 1u);
}

static uint32_t timer_count(const struct native *n, uint32_t t)
{
	const struct timer *const s = &n->s.timers[t];

	if ((n->s.words[n->devices[TIMER][t]][T_CR1] & CEN) == 0u)
		return s->stopped_at;
	const uint64_t count = (native_now(n) - s->anchor) * n->s.timer_clock[n->advanced[t]] / (TIME_HZ * (s->psc + 1u));

	return count < s->arr ? (uint32_t)count : s->arr;
}

static uint32_t timer_source(uint32_t t, uint32_t k)
{
	return TIMER_SOURCE + 5u * t + k;
}

/* Is request `k` (0 update, 1 to 4 channels) made at all, and by updates? */
static bool timer_asks(const struct native *n, uint32_t t, uint32_t k)
{
	return n->s.words[n->devices[TIMER][t]][T_DIER] >> (8u + k) & 1u;
}

static bool timer_at_update(const struct native *n, uint32_t t, uint32_t k)
{
	return k == 0u || (n->s.words[n->devices[TIMER][t]][T_CR2] & CCDS) != 0u;
}

/* The port whose register request `k` moves items to or from; PORTS: none. */
static uint32_t timer_port(struct native *n, uint32_t t, uint32_t k)
{
	const uint32_t distance = (native_target(n, timer_source(t, k)) - n->bases[n->devices[PORT][0]]) / PORT_BYTES;

	return distance < PORTS ? distance : PORTS;
}

static bool timer_preloads(const struct native *n, uint32_t t, uint32_t channel)
{
	return n->s.words[n->devices[TIMER][t]][T_CCMR1 + channel / 2u] >> (3u + 8u * (channel % 2u)) & 1u;
}

/* What was preloaded takes effect. */
static void timer_load(struct native *n, uint32_t t)
{
	const uint32_t *const w = timer_words(n, t);
	struct timer *const s = &n->s.timers[t];

	s->arr = w[T_ARR];
	s->psc = w[T_PSC];
	memcpy(s->ccr, w + T_CCR1, sizeof s->ccr);
}

static void timer_update_irq(struct native *n, uint32_t t)
{
	const uint32_t device = n->devices[TIMER][t];

	engine_irq(n->e, n->irqs[device][0], (timer_words(n, t)[T_SR] & timer_words(n, t)[T_DIER] & UIF) != 0u);
}

/* Goes through `updates` updates or fewer; returns how many. */
static uint64_t timer_run(struct native *n, uint32_t t, uint64_t updates)
{
	const uint64_t length = timer_period(n, t);

	timer_words(n, t)[T_SR] |= UIF;
	timer_load(n, t);
	timer_update_irq(n, t);
	return timer_period(n, t) == length ? updates : 1u;
}

/* ---- requests ---- */

/* The cycle at which request `k` is made first after `since`; NEVER: it is not. */
static uint64_t timer_next(struct native *n, uint32_t t, uint32_t k, uint64_t since)
{
	const uint32_t *const w = timer_words(n, t);
	const struct timer *const s = &n->s.timers[t];
	const uint64_t length = timer_period(n, t);
	uint64_t first = s->anchor, at;

	if ((w[T_CR1] & CEN) == 0u)
		return NEVER;
	if (timer_at_update(n, t, k)) {
		if (w[T_CR1] & UDIS)
			return NEVER;
		first += length;
	} else {
		if (s->ccr[k - 1u] > s->arr)
			return NEVER;
		first += timer_cycles(n, t, s->ccr[k - 1u]);
	}
	at = first > since ? first : first + ((since - first) / length + 1u) * length;
	return (w[T_CR1] & OPM) != 0u && at > s->anchor + length ? NEVER : at;
}

/* Up to `count` items of request `k`, the first at `start`; returns how many requests that were, 0 on failure. */
static uint32_t timer_move(struct native *n, uint32_t t, uint32_t k, uint64_t start, uint64_t count)
{
	const uint32_t source = timer_source(t, k), port = timer_port(n, t, k);
	const uint32_t address = native_target(n, source), available = native_available(n, source);
	const uint32_t word = (address & (PORT_BYTES - 1u)) >> 2, shift = 8u * (address & 3u);
	uint32_t items[PERIODS], part = count < PERIODS ? (uint32_t)count : PERIODS;

	if (available == 0u) {
		n->s.timers[t].pending |= 1u << k;
		return part;
	}
	part = part < available ? part : available;
	if (native_to_memory(n, source)) {
		pins_sample(n, port, word, shift, items, part, start, timer_period(n, t));
		return native_give(n, source, items, part);
	}
	part = native_take(n, source, items, part);
	pins_put(n, port, word, shift, items, part, start, timer_period(n, t));
	return part;
}

/* Makes all of them until `now`. Streams of one port take turns; others move as many items at once as there are. */
static void timer_pace(struct native *n, uint32_t t, uint64_t now)
{
	struct timer *const s = &n->s.timers[t];
	const uint64_t length = timer_period(n, t);
	uint64_t served[CHANNELS + 1u];

	for (uint32_t k = 0; k <= CHANNELS; ++k)
		served[k] = s->served;
	while (!n->failed) {
		uint64_t due[CHANNELS + 1u], until = now;
		uint32_t first = 0;

		for (uint32_t k = 0; k <= CHANNELS; ++k) {
			due[k] = timer_asks(n, t, k) ? timer_next(n, t, k, served[k]) : NEVER;
			if (due[k] < due[first])
				first = k;
		}
		if (due[first] > now)
			break;
		for (uint32_t k = 0; k <= CHANNELS; ++k)
			if (k != first && due[k] <= until && timer_port(n, t, k) < PORTS && timer_port(n, t, k) == timer_port(n, t, first))
				until = due[k];
		const uint32_t moved = timer_move(n, t, first, due[first], (until - due[first]) / length + 1u);

		if (moved == 0u)
			break;
		served[first] = due[first] + (moved - 1u) * length;
	}
	s->served = now;
}

void timers_sync_ports(struct native *n)
{
	for (uint32_t t = 0; t < TIMERS; ++t)
		if (n->s.timers[t].feeds_ports)
			timer_sync(n, t);
}

/* Will the next update change when requests are made? */
static bool timer_changes(const struct native *n, uint32_t t)
{
	const uint32_t *const w = n->s.words[n->devices[TIMER][t]];
	const struct timer *const s = &n->s.timers[t];

	return (w[T_CR1] & (CEN | UDIS)) == CEN &&
	       (s->arr != w[T_ARR] || s->psc != w[T_PSC] || memcmp(s->ccr, w + T_CCR1, sizeof s->ccr) != 0);
}

static void timer_sync_to(struct native *n, uint32_t t, uint64_t now)
{
	uint32_t *const w = timer_words(n, t);
	struct timer *const s = &n->s.timers[t];

	if (w[T_DIER] >> 8 != 0u)
		timer_pace(n, t, now);
	else
		s->served = now;
	if ((w[T_CR1] & (CEN | UDIS)) != CEN)
		return;
	uint64_t length = timer_period(n, t), updates = now < s->anchor ? 0u : (now - s->anchor) / length;

	while (updates != 0u && !n->failed) {
		if (w[T_CR1] & OPM)
			updates = 1;
		s->anchor += timer_run(n, t, updates) * length;
		if (w[T_CR1] & OPM) {
			w[T_CR1] &= ~(uint32_t)CEN;
			s->stopped_at = 0;
			break;
		}
		length = timer_period(n, t); /* ARR or PSC may be others now */
		updates = now < s->anchor ? 0u : (now - s->anchor) / length;
	}
}

void timer_sync(struct native *n, uint32_t t)
{
	const struct timer *const s = &n->s.timers[t];
	const uint64_t now = native_now(n);

	while (!n->failed && timer_changes(n, t) && timer_words(n, t)[T_DIER] >> 8 != 0u && now > s->anchor + timer_period(n, t))
		timer_sync_to(n, t, s->anchor + timer_period(n, t));
	timer_sync_to(n, t, now);
}

void timer_plan(struct native *n, uint32_t t)
{
	const uint32_t device = n->devices[TIMER][t];
	const uint32_t *const w = device_words(n, device);
	const bool rings = (w[T_CR1] & (CEN | UDIS)) == CEN && (w[T_DIER] & UIF) != 0u;
	uint64_t due = rings ? n->s.timers[t].anchor + timer_period(n, t) : NEVER;

	for (uint32_t k = 0; k <= CHANNELS; ++k) {
		const uint32_t available = timer_asks(n, t, k) ? native_available(n, timer_source(t, k)) : 0u;
		const uint64_t next = available != 0u ? timer_next(n, t, k, n->s.timers[t].served) : NEVER;

		if (next != NEVER && next + (available - 1u) * timer_period(n, t) < due)
			due = next + (available - 1u) * timer_period(n, t);
		if (available != 0u && timer_changes(n, t) && n->s.timers[t].anchor + timer_period(n, t) < due)
			due = n->s.timers[t].anchor + timer_period(n, t);
	}
	engine_set_alarm(n->e, n->alarms[device], due);
}

uint64_t native_timer_rings(struct native *n, uint32_t t)
{
	const uint32_t *const w = timer_words(n, t);

	timer_sync(n, t);
	if ((w[T_CR1] & (CEN | UDIS)) != CEN || (w[T_DIER] & UIF) == 0u)
		return NEVER;
	return n->s.timers[t].anchor + timer_period(n, t);
}

static void timer_driver_sync(struct native *n, uint32_t source)
{
	timer_sync(n, (source - TIMER_SOURCE) / 5u);
}

static void timer_driver_changed(struct native *n, uint32_t source)
{
	const uint32_t t = (source - TIMER_SOURCE) / 5u;
	struct timer *const s = &n->s.timers[t];

	timer_sync(n, t);
	s->feeds_ports = 0;
	for (uint32_t k = 0; k <= CHANNELS; ++k) {
		s->feeds_ports |= timer_port(n, t, k) != PORTS;
		if ((s->pending >> k & 1u) != 0u && native_available(n, timer_source(t, k)) != 0u) {
			s->pending &= ~(1u << k);
			(void)timer_move(n, t, k, native_now(n), 1);
		}
	}
	timer_plan(n, t);
}

const struct driver timer_driver = {.sync = timer_driver_sync, .changed = timer_driver_changed};

void timer_reset(struct native *n, uint32_t t)
{
	const uint32_t device = n->devices[TIMER][t];

	memset(&n->s.timers[t], 0, sizeof n->s.timers[t]);
	timer_load(n, t);
	engine_set_alarm(n->e, n->alarms[device], NEVER);
	engine_irq(n->e, n->irqs[device][0], false);
}

void timer_clocks(struct native *n, uint64_t apb1, uint64_t apb2)
{
	uint32_t counts[TIMERS];

	for (uint32_t t = 0; t < TIMERS; ++t) {
		timer_sync(n, t);
		counts[t] = timer_count(n, t);
	}
	n->s.timer_clock[0] = apb1;
	n->s.timer_clock[1] = apb2;
	for (uint32_t t = 0; t < TIMERS; ++t) {
		n->s.timers[t].anchor = native_now(n) - timer_cycles(n, t, counts[t]);
		timer_plan(n, t);
	}
}

uint32_t timer_read(struct native *n, uint32_t device, uint32_t word)
{
	const uint32_t t = n->numbers[device];
	uint32_t *const w = device_words(n, device);

	if (word != T_CNT && word != T_SR && word != T_CR1 && (word < T_CCR1 || word > T_CCR4))
		return w[word];
	timer_sync(n, t);
	if (word == T_CNT)
		return timer_count(n, t);
	if (word == T_SR && (w[T_CR1] & CEN) != 0u)
		for (uint32_t c = 0; c < CHANNELS; ++c)
			if (n->s.timers[t].ccr[c] != 0u && timer_count(n, t) >= n->s.timers[t].ccr[c])
				w[T_SR] |= 2u << c;
	return w[word];
}

static void timer_generate(struct native *n, uint32_t t, uint32_t value)
{
	uint32_t *const w = timer_words(n, t);
	struct timer *const s = &n->s.timers[t];

	if (value & 1u) {
		s->anchor = native_now(n);
		s->stopped_at = 0;
		timer_load(n, t);
		if ((w[T_CR1] & URS) == 0u) {
			w[T_SR] |= UIF;
			for (uint32_t k = 0; k <= CHANNELS; ++k)
				if (timer_asks(n, t, k) && timer_at_update(n, t, k))
					(void)timer_move(n, t, k, native_now(n), 1);
			timer_update_irq(n, t);
		}
	}
	w[T_SR] |= value & 0x1Eu;
}

void timer_write(struct native *n, uint32_t device, uint32_t word, uint32_t value)
{
	const uint32_t t = n->numbers[device];
	struct timer *const s = &n->s.timers[t];
	uint32_t *const w = device_words(n, device);
	uint32_t count, changed;

	if (word == T_SR) {
		(void)timer_read(n, device, T_SR);
		w[T_SR] &= value;
		timer_update_irq(n, t);
		return;
	}
	timer_sync(n, t);
	switch (word) {
	case T_CCER:
	case T_DMAR:
		if (value != 0u)
			native_query(n, QUERY_OUTPUT, n->devices[TIMER][t], word == T_CCER, value);
		return;
	case T_EGR:
		timer_generate(n, t, value);
		break;
	case T_CNT:
		s->stopped_at = value;
		s->anchor = native_now(n) - timer_cycles(n, t, value);
		break;
	case T_CR1:
		count = timer_count(n, t);
		changed = device_keep(n, device, word, value);
		if (changed & CEN) {
			if (w[T_CR1] & CEN)
				s->anchor = native_now(n) - timer_cycles(n, t, count);
			else
				s->stopped_at = count;
		}
		break;
	default:
		device_keep(n, device, word, value);
		if (word == T_ARR && (w[T_CR1] & ARPE) == 0u)
			s->arr = w[T_ARR];
		if (word >= T_CCR1 && word <= T_CCR4 && !timer_preloads(n, t, word - T_CCR1))
			s->ccr[word - T_CCR1] = w[word];
		if (word == T_DIER) {
			for (uint32_t k = 0; k <= CHANNELS; ++k)
				if (!timer_asks(n, t, k))
					s->pending &= ~(1u << k);
			timer_update_irq(n, t);
		}
		break;
	}
	timer_plan(n, t);
}
