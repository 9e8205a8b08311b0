/* DMA1 and DMA2 in C: sim/board/peripherals/dma.py says what they do and why. */
#include <string.h>

#include "native.h"

enum { LISR = 0, HISR = 1, LIFCR = 2, HIFCR = 3 };
enum { S_CR = 4, S_NDTR = 5, S_PAR = 6, S_M0AR = 7, S_STEP = 6 }; /* words of stream 0 */
enum { CR_EN = 1u << 0, CR_DIR = 3u << 6, CR_READS = 1u << 6, CR_CIRC = 1u << 8, CR_MINC = 1u << 10 };
enum { CR_INTERRUPTS = 0x1Eu };
enum { FLAG_HT = 1u << 4, FLAG_TC = 1u << 5, FLAGS = 0x3Du, FLAGS_WITH_INTERRUPT = 0x3Cu };

static uint32_t *stream_words(struct hot *h, uint32_t controller, uint32_t stream)
{
	return words(h, h->controllers[controller]) + S_CR + S_STEP * stream;
}

static uint32_t flag_shift(uint32_t stream)
{
	return (stream % 4u) / 2u * 16u + stream % 2u * 6u;
}

static void stream_update(struct hot *h, uint32_t controller, uint32_t stream)
{
	const uint32_t device = h->controllers[controller];
	const uint32_t flags = words(h, device)[stream < 4u ? LISR : HISR] >> flag_shift(stream) & FLAGS_WITH_INTERRUPT;
	/* DMEIE TEIE HTIE TCIE are bits 1 to 4, their flags bits 2 to 5. */
	const uint32_t enabled = (stream_words(h, controller, stream)[0] & CR_INTERRUPTS) << 1;

	engine_irq(h->e, h->irqs[device][stream], (flags & enabled) != 0u);
}

static void stream_raise(struct hot *h, uint32_t controller, uint32_t stream, uint32_t flags)
{
	words(h, h->controllers[controller])[stream < 4u ? LISR : HISR] |= flags << flag_shift(stream);
	stream_update(h, controller, stream);
}

void stream_unlink(struct hot *h, uint32_t controller, uint32_t stream)
{
	struct stream *const s = &h->s.streams[controller][stream];

	for (uint32_t i = 0; i < SHARED; ++i)
		if (s->sources[i] >= 0)
			h->s.stream_of[s->sources[i]] = -1;
	for (uint32_t i = 0; i < SHARED; ++i)
		s->sources[i] = -1;
}

static void source_sync(struct hot *h, uint32_t source)
{
	if (now(h) >= h->s.due[source])
		h->s.due[source] = NEVER; /* it says anew */
	h->source(source, true);
}

/* The driver of a request brings itself up to now, or hears that a stream came or went. */
static void drive(struct hot *h, int32_t source, bool sync)
{
	if (source < 0)
		return;
	if (source >= PYTHON_SOURCE) {
		if (!sync)
			h->source((uint32_t)source, false);
		else if (now(h) >= h->s.due[source])
			source_sync(h, (uint32_t)source);
	} else if (source < TIMER_SOURCE) {
		(sync ? spi_sync : spi_dma_changed)(h);
	} else {
		(sync ? timer_sync : timer_dma_changed)(h, (uint32_t)(source - TIMER_SOURCE) / 5u);
	}
}

static void stream_sync(struct hot *h, uint32_t controller, uint32_t stream)
{
	drive(h, h->s.streams[controller][stream].sources[0], true);
}

/* Before its count is read or it is stopped: what moves without alarms shows itself too. */
static void drive_for(struct hot *h, uint32_t controller, uint32_t stream)
{
	const int32_t source = h->s.streams[controller][stream].sources[0];

	if (source >= PYTHON_SOURCE && (h->lazy >> source & 1u) != 0u)
		source_sync(h, (uint32_t)source);
	else
		stream_sync(h, controller, stream);
}

/* An alarm is for what interrupts or can be noticed: otherwise the driver is asked when the program looks. */
static void source_plan(struct hot *h, uint32_t source)
{
	const int16_t place = h->s.stream_of[source];
	const bool rings =
		place < 0 || (h->s.quiet >> source & 1u) == 0u || (stream_words(h, (uint32_t)place / STREAMS, (uint32_t)place % STREAMS)[0] & CR_INTERRUPTS) != 0u;

	if (h->s.source_alarms[source] != UINT32_MAX)
		engine_set_alarm(h->e, h->s.source_alarms[source], rings ? h->s.due[source] : NEVER);
}

/* At `cycle` a source of Python will have something to move. */
void hot_wake(struct hot *h, uint32_t source, uint32_t alarm, uint64_t cycle, bool quiet)
{
	const uint64_t bit = UINT64_C(1) << source;

	h->s.due[source] = cycle;
	h->s.quiet = quiet ? h->s.quiet | bit : h->s.quiet & ~bit;
	h->s.source_alarms[source] = alarm;
	source_plan(h, source);
}

/* Before flags are read. Of a quiet stream that goes round and round they stay as they are once both are up. */
static void flags_sync(struct hot *h, uint32_t controller, uint32_t stream)
{
	const int32_t source = h->s.streams[controller][stream].sources[0];
	const uint32_t flags = words(h, h->controllers[controller])[stream < 4u ? LISR : HISR] >> flag_shift(stream);
	const bool rounds = (stream_words(h, controller, stream)[0] & CR_CIRC) != 0u;

	if (source >= PYTHON_SOURCE && rounds && (h->lazy & h->s.quiet) >> source & 1u &&
	    (flags & (FLAG_HT | FLAG_TC)) == (FLAG_HT | FLAG_TC))
		return;
	stream_sync(h, controller, stream);
}

/* All streams of a controller have moved what they have until now. */
void hot_sync(struct hot *h, uint32_t controller)
{
	for (uint32_t stream = 0; stream < STREAMS; ++stream)
		drive_for(h, controller, stream);
}

/* Items until a stream is half through or at its end. */
uint32_t hot_until_flag(struct hot *h, uint32_t source)
{
	const int16_t place = h->s.stream_of[source];

	if (place < 0)
		return 0;
	const struct stream *const s = &h->s.streams[place / STREAMS][place % STREAMS];
	const uint32_t half = s->total - s->total / 2u;

	return (s->moved < half ? half : s->total) - s->moved;
}

uint32_t hot_total(struct hot *h, uint32_t source)
{
	const int16_t place = h->s.stream_of[source];

	return place < 0 ? 0 : h->s.streams[place / STREAMS][place % STREAMS].total;
}

uint32_t hot_available(struct hot *h, uint32_t source)
{
	const int16_t place = h->s.stream_of[source];

	if (place < 0)
		return 0;
	const struct stream *const s = &h->s.streams[place / STREAMS][place % STREAMS];

	return s->total - s->moved;
}

uint32_t hot_target(struct hot *h, uint32_t source)
{
	const int16_t place = h->s.stream_of[source];

	return place < 0 ? 0 : stream_words(h, (uint32_t)place / STREAMS, (uint32_t)place % STREAMS)[2];
}

bool hot_circular(struct hot *h, uint32_t source)
{
	const int16_t place = h->s.stream_of[source];

	return place >= 0 &&
	       (stream_words(h, (uint32_t)place / STREAMS, (uint32_t)place % STREAMS)[0] & CR_CIRC) != 0u;
}

static void advance(struct hot *h, uint32_t controller, uint32_t stream, uint32_t count)
{
	struct stream *const s = &h->s.streams[controller][stream];
	uint32_t *const w = stream_words(h, controller, stream);
	const uint32_t half = s->total - s->total / 2u;
	uint32_t flags = 0, after = s->moved + count;

	if (s->moved < half && after >= half)
		flags |= FLAG_HT;
	if (after == s->total) {
		flags |= FLAG_TC;
		if (w[0] & CR_CIRC) {
			after = 0;
		} else {
			w[0] &= ~(uint32_t)CR_EN;
			stream_unlink(h, controller, stream);
		}
	}
	s->moved = after;
	w[1] = s->total - after;
	if (flags != 0u)
		stream_raise(h, controller, stream, flags);
}

/* Moves `count` items between `items` and memory; returns how many there were. */
static uint32_t move(struct hot *h, uint32_t source, uint32_t *items, uint32_t count, bool to_memory)
{
	const int16_t place = h->s.stream_of[source];
	uint32_t done = 0;

	if (place < 0)
		return 0;
	const uint32_t controller = (uint32_t)place / STREAMS, stream = (uint32_t)place % STREAMS;
	struct stream *const s = &h->s.streams[controller][stream];
	uint32_t *const w = stream_words(h, controller, stream);

	while (done < count && s->total != s->moved && h->s.stream_of[source] == place) {
		const uint32_t size = 1u << (w[0] >> 11 & 3u), step = w[0] & CR_MINC ? size : 0u;
		const uint32_t left = s->total - s->moved, part = count - done < left ? count - done : left;
		const uint32_t address = w[3];

		if (address >= SRAM_BASE && address < SRAM_END && engine_cached(h->e, address)) {
			ask(h, ASK_CACHED, controller, stream, address);
			return done;
		}
		uint8_t *at = engine_memory(h->e, address + s->moved * step, step ? part * size : size);

		if (at == NULL)
			return done;
		for (uint32_t i = 0; i < part; ++i, at += step) {
			if (to_memory) {
				memcpy(at, &items[done + i], size); /* little-endian on both sides */
			} else {
				items[done + i] = 0;
				memcpy(&items[done + i], at, size);
			}
		}
		done += part;
		advance(h, controller, stream, part);
	}
	return done;
}

uint32_t hot_take(struct hot *h, uint32_t source, uint32_t *items, uint32_t count)
{
	return move(h, source, items, count, false);
}

uint32_t hot_give(struct hot *h, uint32_t source, uint32_t *items, uint32_t count)
{
	return move(h, source, items, count, true);
}

/* Python's answer to ASK_ENABLE. */
void hot_set_source(struct hot *h, uint32_t controller, uint32_t stream, uint32_t place, int32_t source)
{
	h->s.streams[controller][stream].judged[place] = source;
}

static void stream_enable(struct hot *h, uint32_t controller, uint32_t stream)
{
	struct stream *const s = &h->s.streams[controller][stream];
	uint32_t *const w = stream_words(h, controller, stream);
	const uint32_t cr = w[0] & ~(uint32_t)CR_INTERRUPTS;
	const uint32_t flags = words(h, h->controllers[controller])[stream < 4u ? LISR : HISR] >> flag_shift(stream);
	static const int32_t none[SHARED] = {-1, -1, -1};
	const bool cached = w[3] >= SRAM_BASE && w[3] < SRAM_END && engine_cached(h->e, w[3]);

	if (cached || (flags & FLAGS) != 0u || s->epoch != h->s.epoch || s->cr != cr || s->par != w[2] || s->m0ar != w[3] ||
	    s->ndtr != w[1]) {
		memcpy(s->judged, none, sizeof none);
		ask(h, ASK_ENABLE, controller, stream, 0);
		if (h->failed)
			return;
		s->cr = cr, s->ndtr = w[1], s->par = w[2], s->m0ar = w[3], s->epoch = h->s.epoch;
	}
	/* What has passed until now passed without the stream. */
	if (s->judged[0] >= PYTHON_SOURCE)
		h->source((uint32_t)s->judged[0], true);
	else
		drive(h, s->judged[0], true);
	memcpy(s->sources, s->judged, sizeof s->sources);
	s->total = w[1];
	s->moved = 0;
	for (uint32_t i = 0; i < SHARED && s->sources[i] >= 0; ++i) {
		if (h->s.stream_of[s->sources[i]] >= 0) {
			ask(h, ASK_TWICE, controller, stream, (uint32_t)s->sources[i]);
			return;
		}
		h->s.stream_of[s->sources[i]] = (int16_t)(controller * STREAMS + stream);
	}
	drive(h, s->sources[0], false);
}

static void stream_write_cr(struct hot *h, uint32_t controller, uint32_t stream, uint32_t value)
{
	const uint32_t device = h->controllers[controller], slot = S_CR + S_STEP * stream;
	struct stream *const s = &h->s.streams[controller][stream];

	drive_for(h, controller, stream);
	const uint32_t before = words(h, device)[slot];

	if ((before & CR_EN) != 0u && ((before ^ value) & ~(uint32_t)(CR_EN | CR_INTERRUPTS)) != 0u) {
		ask(h, ASK_CHANGED, controller, stream, value);
		return;
	}
	keep(h, device, slot, value);
	if ((value & CR_EN) != 0u && (before & CR_EN) == 0u) {
		stream_enable(h, controller, stream);
	} else if ((before & CR_EN) != 0u && (value & CR_EN) == 0u) {
		const int32_t source = s->sources[0];

		stream_unlink(h, controller, stream);
		stream_raise(h, controller, stream, FLAG_TC);
		drive(h, source, false);
	}
	stream_update(h, controller, stream);
	if (s->sources[0] >= PYTHON_SOURCE)
		source_plan(h, (uint32_t)s->sources[0]);
}

/* Can what has passed have ended the stream? Programs poll for that while bytes are on the wire. */
static bool stream_may_have_ended(struct hot *h, uint32_t controller, uint32_t stream)
{
	const int32_t source = h->s.streams[controller][stream].sources[0];

	if (source != SPI_RX && source != SPI_TX)
		return true;
	if (h->s.begun == NEVER)
		return true;
	const uint64_t passed = (now(h) - h->s.begun) / byte_cycles(h);

	if (source == SPI_RX)
		return passed >= hot_available(h, SPI_RX);
	return h->s.sending_count + spi_waiting(h) <= passed + FIFO_BYTES + 1u;
}

uint32_t dma_read(struct hot *h, uint32_t device, uint32_t slot)
{
	const uint32_t controller = h->numbers[device];

	if (slot == LISR || slot == HISR) {
		for (uint32_t i = 0; i < 4u; ++i)
			flags_sync(h, controller, i + (slot == HISR ? 4u : 0u));
	} else if (slot >= S_CR && (slot - S_CR) % S_STEP == 0u) {
		if (stream_may_have_ended(h, controller, (slot - S_CR) / S_STEP))
			stream_sync(h, controller, (slot - S_CR) / S_STEP);
	} else if (slot >= S_CR && (slot - S_CR) % S_STEP == 1u) {
		drive_for(h, controller, (slot - S_CR) / S_STEP);
	}
	return words(h, device)[slot];
}

void dma_write(struct hot *h, uint32_t device, uint32_t slot, uint32_t value)
{
	const uint32_t controller = h->numbers[device];

	if (slot == LIFCR || slot == HIFCR) {
		const uint32_t first = slot == LIFCR ? 0u : 4u;

		for (uint32_t i = first; i < first + 4u; ++i) {
			if ((value >> flag_shift(i) & FLAGS) == 0u)
				continue;
			stream_sync(h, controller, i);
			words(h, device)[slot - 2u] &= ~(value & FLAGS << flag_shift(i));
			stream_update(h, controller, i);
		}
		return;
	}
	const uint32_t stream = (slot - S_CR) / S_STEP;

	if ((slot - S_CR) % S_STEP == 0u) {
		stream_write_cr(h, controller, stream, value);
		return;
	}
	stream_sync(h, controller, stream);
	if ((words(h, device)[S_CR + S_STEP * stream] & CR_EN) != 0u)
		ask(h, ASK_FROZEN, controller, stream, slot);
	else
		keep(h, device, slot, value);
}

static bool reads_dtcm(const uint32_t *w)
{
	return (w[0] & (CR_EN | CR_DIR)) == (CR_EN | CR_READS) && w[3] >= DTCM_BASE && w[3] < SRAM_BASE;
}

void hot_sleep(void)
{
	struct hot *const h = hot_current;

	h->failed = false;
	for (uint32_t i = 0; i < 2u * STREAMS && !h->failed; ++i) {
		const uint32_t controller = i / STREAMS, stream = i % STREAMS;

		if (!reads_dtcm(stream_words(h, controller, stream)))
			continue;
		drive_for(h, controller, stream); /* it may have ended */
		if (reads_dtcm(stream_words(h, controller, stream)))
			ask(h, ASK_ASLEEP, controller, stream, 0);
	}
}
