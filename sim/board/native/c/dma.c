/* DMA1 and DMA2 (RM0431 8): streams between memory and the peripherals that make requests.
 *
 * Drivers know the time and move many items at once. A driver says with take and give what it has moved up to now, and
 * is told to bring itself up to now before the program reads what could show it. So a transfer costs one event and
 * still shows the right count at every cycle. */
#include <string.h>

#include "peripherals.h"

enum { LISR = 0, HISR = 1, LIFCR = 2, HIFCR = 3 };
enum { S_CR = 4, S_NDTR = 5, S_PAR = 6, S_M0AR = 7, S_STEP = 6 }; /* words of stream 0 */
enum { CR_EN = 1u << 0, CR_DIR = 3u << 6, CR_READS = 1u << 6, CR_CIRC = 1u << 8, CR_MINC = 1u << 10 };
enum { CR_INTERRUPTS = 0x1Eu };
enum { FLAG_HT = 1u << 4, FLAG_TC = 1u << 5, FLAGS = 0x3Du, FLAGS_WITH_INTERRUPT = 0x3Cu };

static uint32_t *dma_words(struct native *n, uint32_t controller, uint32_t stream)
{
	return device_words(n, n->devices[DMA][controller]) + S_CR + S_STEP * stream;
}

static uint32_t dma_shift(uint32_t stream)
{
	return (stream % 4u) / 2u * 16u + stream % 2u * 6u;
}

static void dma_update(struct native *n, uint32_t controller, uint32_t stream)
{
	const uint32_t device = n->devices[DMA][controller];
	const uint32_t flags = device_words(n, device)[stream < 4u ? LISR : HISR] >> dma_shift(stream) & FLAGS_WITH_INTERRUPT;
	/* DMEIE TEIE HTIE TCIE are bits 1 to 4, their flags bits 2 to 5. */
	const uint32_t enabled = (dma_words(n, controller, stream)[0] & CR_INTERRUPTS) << 1;

	engine_irq(n->e, n->irqs[device][stream], (flags & enabled) != 0u);
}

static void dma_raise(struct native *n, uint32_t controller, uint32_t stream, uint32_t flags)
{
	device_words(n, n->devices[DMA][controller])[stream < 4u ? LISR : HISR] |= flags << dma_shift(stream);
	dma_update(n, controller, stream);
}

static void dma_unlink(struct native *n, uint32_t controller, uint32_t stream)
{
	struct stream *const s = &n->s.streams[controller][stream];

	for (uint32_t i = 0; i < SHARED; ++i)
		if (s->sources[i] >= 0)
			n->s.stream_of[s->sources[i]] = -1;
	for (uint32_t i = 0; i < SHARED; ++i)
		s->sources[i] = -1;
}

static void dma_source_sync(struct native *n, uint32_t source)
{
	if (native_now(n) >= n->s.due[source])
		n->s.due[source] = NEVER; /* it says anew */
	n->callbacks.source(source, true);
}

/* The driver of a request brings itself up to now. */
static void dma_drive(struct native *n, int32_t source)
{
	if (source < 0)
		return;
	if (source < PYTHON_SOURCE)
		n->drivers[source]->sync(n, (uint32_t)source);
	else if (native_now(n) >= n->s.due[source])
		dma_source_sync(n, (uint32_t)source);
}

/* Tells it that a stream came or went. */
static void dma_tell(struct native *n, int32_t source)
{
	if (source >= PYTHON_SOURCE)
		n->callbacks.source((uint32_t)source, false);
	else if (source >= 0)
		n->drivers[source]->changed(n, (uint32_t)source);
}

static void dma_sync(struct native *n, uint32_t controller, uint32_t stream)
{
	dma_drive(n, n->s.streams[controller][stream].sources[0]);
}

/* Before its count is read or it is stopped: what moves without alarms shows itself too. */
static void dma_sync_all(struct native *n, uint32_t controller, uint32_t stream)
{
	const int32_t source = n->s.streams[controller][stream].sources[0];

	if (source >= PYTHON_SOURCE && (n->lazy >> source & 1u) != 0u)
		dma_source_sync(n, (uint32_t)source);
	else
		dma_sync(n, controller, stream);
}

/* Sets the alarm only for what interrupts or shows by itself: otherwise the driver moves at the next read. */
static void dma_source_plan(struct native *n, uint32_t source)
{
	const bool rings = n->s.stream_of[source] < 0 || (n->s.quiet >> source & 1u) == 0u || native_rings(n, source);

	if (n->s.source_alarms[source] != UINT32_MAX)
		engine_set_alarm(n->e, n->s.source_alarms[source], rings ? n->s.due[source] : NEVER);
}

void native_wake(struct native *n, uint32_t source, uint32_t alarm, uint64_t cycle, bool quiet)
{
	const uint64_t bit = UINT64_C(1) << source;

	n->s.due[source] = cycle;
	n->s.quiet = quiet ? n->s.quiet | bit : n->s.quiet & ~bit;
	n->s.source_alarms[source] = alarm;
	dma_source_plan(n, source);
}

/* Before flags are read. Of a quiet stream that goes round and round they stay as they are once both are up. */
static void dma_flags_sync(struct native *n, uint32_t controller, uint32_t stream)
{
	const int32_t source = n->s.streams[controller][stream].sources[0];
	const uint32_t flags = device_words(n, n->devices[DMA][controller])[stream < 4u ? LISR : HISR] >> dma_shift(stream);
	const bool rounds = (dma_words(n, controller, stream)[0] & CR_CIRC) != 0u;

	if (source >= PYTHON_SOURCE && rounds && (n->lazy & n->s.quiet) >> source & 1u &&
	    (flags & (FLAG_HT | FLAG_TC)) == (FLAG_HT | FLAG_TC))
		return;
	dma_sync(n, controller, stream);
}

void native_sync(struct native *n, uint32_t controller)
{
	for (uint32_t stream = 0; stream < STREAMS; ++stream)
		dma_sync_all(n, controller, stream);
}

/* The stream that serves a request; NULL: none is enabled. */
static const struct stream *dma_serving(const struct native *n, uint32_t source)
{
	const int16_t place = n->s.stream_of[source];

	return place < 0 ? NULL : &n->s.streams[place / STREAMS][place % STREAMS];
}

/* A word of that stream, from its CR on; 0 without one. */
static uint32_t dma_serving_word(const struct native *n, uint32_t source, uint32_t word)
{
	const int16_t place = n->s.stream_of[source];

	return place < 0 ? 0 : n->s.words[n->devices[DMA][place / STREAMS]][S_CR + S_STEP * ((uint32_t)place % STREAMS) + word];
}

uint32_t native_until_flag(struct native *n, uint32_t source)
{
	const struct stream *const s = dma_serving(n, source);

	return s == NULL ? 0 : (s->moved < s->total - s->total / 2u ? s->total - s->total / 2u : s->total) - s->moved;
}

uint32_t native_total(struct native *n, uint32_t source)
{
	const struct stream *const s = dma_serving(n, source);

	return s == NULL ? 0 : s->total;
}

uint32_t native_available(struct native *n, uint32_t source)
{
	const struct stream *const s = dma_serving(n, source);

	return s == NULL ? 0 : s->total - s->moved;
}

uint32_t native_target(struct native *n, uint32_t source)
{
	return dma_serving_word(n, source, S_PAR - S_CR);
}

bool native_to_memory(struct native *n, uint32_t source)
{
	return (dma_serving_word(n, source, 0) & CR_DIR) == 0u;
}

bool native_circular(struct native *n, uint32_t source)
{
	return (dma_serving_word(n, source, 0) & CR_CIRC) != 0u;
}

bool native_rings(const struct native *n, uint32_t source)
{
	return (dma_serving_word(n, source, 0) & CR_INTERRUPTS) != 0u;
}

static void dma_advance(struct native *n, uint32_t controller, uint32_t stream, uint32_t count)
{
	struct stream *const s = &n->s.streams[controller][stream];
	uint32_t *const w = dma_words(n, controller, stream);
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
			dma_unlink(n, controller, stream);
		}
	}
	s->moved = after;
	w[1] = s->total - after;
	if (flags != 0u)
		dma_raise(n, controller, stream, flags);
}

static uint32_t dma_move(struct native *n, uint32_t source, uint32_t *items, uint32_t count, bool to_memory)
{
	const int16_t place = n->s.stream_of[source];
	uint32_t done = 0;

	if (place < 0)
		return 0;
	const uint32_t controller = (uint32_t)place / STREAMS, stream = (uint32_t)place % STREAMS;
	struct stream *const s = &n->s.streams[controller][stream];
	uint32_t *const w = dma_words(n, controller, stream);

	while (done < count && s->total != s->moved && n->s.stream_of[source] == place) {
		const uint32_t size = 1u << (w[0] >> 11 & 3u), step = w[0] & CR_MINC ? size : 0u;
		const uint32_t left = s->total - s->moved, part = count - done < left ? count - done : left;
		const uint32_t address = w[3];

		if (address >= SRAM_BASE && address < SRAM_END && engine_cached(n->e, address)) {
			native_query(n, QUERY_CACHED, n->devices[DMA][controller], stream, address);
			return done;
		}
		uint8_t *at = engine_memory(n->e, address + s->moved * step, step ? part * size : size);

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
		dma_advance(n, controller, stream, part);
	}
	return done;
}

uint32_t native_take(struct native *n, uint32_t source, uint32_t *items, uint32_t count)
{
	return dma_move(n, source, items, count, false);
}

uint32_t native_give(struct native *n, uint32_t source, uint32_t *items, uint32_t count)
{
	return dma_move(n, source, items, count, true);
}

void native_lazy(struct native *n, uint32_t source)
{
	n->lazy |= UINT64_C(1) << source;
}

void native_set_source(struct native *n, uint32_t controller, uint32_t stream, uint32_t place, int32_t source)
{
	struct stream *const s = &n->s.streams[controller][stream];

	s->setups[s->latest].sources[place] = source;
}

/* Is the stream set up as it was when Python found it right? Otherwise it is asked. */
static const struct setup *dma_setup(struct native *n, uint32_t controller, uint32_t stream, bool ask)
{
	static const int32_t none[SHARED] = {-1, -1, -1};
	struct stream *const s = &n->s.streams[controller][stream];
	const uint32_t *const w = dma_words(n, controller, stream);
	const uint32_t cr = w[0] & ~(uint32_t)CR_INTERRUPTS;

	for (uint32_t i = 0; i < SETUPS && !ask; ++i) {
		const struct setup *const known = &s->setups[i];

		if (known->epoch == n->s.epoch && known->cr == cr && known->par == w[2] && known->m0ar == w[3] && known->ndtr == w[1])
			return known;
	}
	s->latest = (s->latest + 1u) % SETUPS;
	struct setup *const found = &s->setups[s->latest];

	found->epoch = 0;
	memcpy(found->sources, none, sizeof none);
	native_query(n, QUERY_ENABLE, n->devices[DMA][controller], stream, 0);
	if (!n->failed)
		found->cr = cr, found->ndtr = w[1], found->par = w[2], found->m0ar = w[3], found->epoch = n->s.epoch;
	return found;
}

static void dma_enable(struct native *n, uint32_t controller, uint32_t stream)
{
	struct stream *const s = &n->s.streams[controller][stream];
	const uint32_t *const w = dma_words(n, controller, stream);
	const uint32_t flags = device_words(n, n->devices[DMA][controller])[stream < 4u ? LISR : HISR] >> dma_shift(stream);
	const bool cached = w[3] >= SRAM_BASE && w[3] < SRAM_END && engine_cached(n->e, w[3]);

	if (engine_stored(n->e)) {
		native_query(n, QUERY_BARRIER, n->devices[DMA][controller], stream, 0);
		return;
	}
	const struct setup *const setup = dma_setup(n, controller, stream, cached || (flags & FLAGS) != 0u);

	if (n->failed)
		return;
	/* What has passed until now passed without the stream. */
	if (setup->sources[0] >= PYTHON_SOURCE)
		n->callbacks.source((uint32_t)setup->sources[0], true);
	else
		dma_drive(n, setup->sources[0]);
	memcpy(s->sources, setup->sources, sizeof s->sources);
	s->total = w[1];
	s->moved = 0;
	for (uint32_t i = 0; i < SHARED && s->sources[i] >= 0; ++i) {
		if (n->s.stream_of[s->sources[i]] >= 0) {
			native_query(n, QUERY_TWICE, n->devices[DMA][controller], stream, (uint32_t)s->sources[i]);
			return;
		}
		n->s.stream_of[s->sources[i]] = (int16_t)(controller * STREAMS + stream);
	}
	dma_tell(n, s->sources[0]);
}

static void dma_write_cr(struct native *n, uint32_t controller, uint32_t stream, uint32_t value)
{
	const uint32_t device = n->devices[DMA][controller], word = S_CR + S_STEP * stream;
	struct stream *const s = &n->s.streams[controller][stream];

	dma_sync_all(n, controller, stream);
	const uint32_t before = device_words(n, device)[word];

	if ((before & CR_EN) != 0u && ((before ^ value) & ~(uint32_t)(CR_EN | CR_INTERRUPTS)) != 0u) {
		native_query(n, QUERY_CHANGED, n->devices[DMA][controller], stream, value);
		return;
	}
	device_keep(n, device, word, value);
	if ((value & CR_EN) != 0u && (before & CR_EN) == 0u) {
		dma_enable(n, controller, stream);
	} else if ((before & CR_EN) != 0u && (value & CR_EN) == 0u) {
		const int32_t source = s->sources[0];

		dma_unlink(n, controller, stream);
		dma_raise(n, controller, stream, FLAG_TC);
		dma_tell(n, source);
	}
	dma_update(n, controller, stream);
	if (s->sources[0] >= PYTHON_SOURCE)
		dma_source_plan(n, (uint32_t)s->sources[0]);
}

/* Can what has passed have ended the stream? Programs poll for that. */
static bool dma_may_have_ended(struct native *n, uint32_t controller, uint32_t stream)
{
	const int32_t source = n->s.streams[controller][stream].sources[0];

	if (source < 0 || source >= PYTHON_SOURCE || n->drivers[source]->may_have_ended == NULL)
		return true;
	return n->drivers[source]->may_have_ended(n, (uint32_t)source);
}

uint32_t dma_read(struct native *n, uint32_t device, uint32_t word)
{
	const uint32_t controller = n->numbers[device];

	if (word == LISR || word == HISR) {
		for (uint32_t i = 0; i < 4u; ++i)
			dma_flags_sync(n, controller, i + (word == HISR ? 4u : 0u));
	} else if (word >= S_CR && (word - S_CR) % S_STEP == 0u) {
		if (dma_may_have_ended(n, controller, (word - S_CR) / S_STEP))
			dma_sync(n, controller, (word - S_CR) / S_STEP);
	} else if (word >= S_CR && (word - S_CR) % S_STEP == 1u) {
		dma_sync_all(n, controller, (word - S_CR) / S_STEP);
	}
	return device_words(n, device)[word];
}

void dma_write(struct native *n, uint32_t device, uint32_t word, uint32_t value)
{
	const uint32_t controller = n->numbers[device];

	if (word == LIFCR || word == HIFCR) {
		const uint32_t first = word == LIFCR ? 0u : 4u;

		for (uint32_t i = first; i < first + 4u; ++i) {
			if ((value >> dma_shift(i) & FLAGS) == 0u)
				continue;
			dma_sync(n, controller, i);
			device_words(n, device)[word - 2u] &= ~(value & FLAGS << dma_shift(i));
			dma_update(n, controller, i);
		}
		return;
	}
	const uint32_t stream = (word - S_CR) / S_STEP;

	if ((word - S_CR) % S_STEP == 0u) {
		dma_write_cr(n, controller, stream, value);
		return;
	}
	dma_sync(n, controller, stream);
	if ((device_words(n, device)[S_CR + S_STEP * stream] & CR_EN) != 0u)
		native_query(n, QUERY_FROZEN, n->devices[DMA][controller], stream, word);
	else
		device_keep(n, device, word, value);
}

static bool dma_reads_dtcm(const uint32_t *w)
{
	return (w[0] & (CR_EN | CR_DIR)) == (CR_EN | CR_READS) && w[3] >= DTCM_BASE && w[3] < SRAM_BASE;
}

void dma_reset(struct native *n, uint32_t controller)
{
	for (uint32_t i = 0; i < STREAMS; ++i) {
		dma_unlink(n, controller, i);
		n->s.streams[controller][i].total = n->s.streams[controller][i].moved = 0;
		engine_irq(n->e, n->irqs[n->devices[DMA][controller]][i], false);
	}
}

void dma_sleep(struct native *n)
{
	for (uint32_t i = 0; i < 2u * STREAMS && !n->failed; ++i) {
		const uint32_t controller = i / STREAMS, stream = i % STREAMS;

		if (!dma_reads_dtcm(dma_words(n, controller, stream)))
			continue;
		dma_sync_all(n, controller, stream); /* it may have ended */
		if (dma_reads_dtcm(dma_words(n, controller, stream)))
			native_query(n, QUERY_ASLEEP, n->devices[DMA][controller], stream, 0);
	}
}
