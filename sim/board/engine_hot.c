/* The peripherals that a flight controller uses ten thousand times a second, behind the engine's callbacks:
 * GPIO, SYSCFG, EXTI, DMA1 and 2, SPI1 and the timers. The classes of the same names in Python say what each
 * does and why; this is the same in C, and the same tests hold both. Python keeps judging: a set-up that has
 * not been seen before is shown to it once, and whatever is wrong is told by it.
 *
 * Of the engine only its public functions are used. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

struct engine;

uint64_t engine_cycle(const struct engine *e);
void engine_irq(struct engine *e, uint32_t number, bool asserted);
void engine_set_alarm(struct engine *e, uint32_t alarm, uint64_t cycle);
uint8_t *engine_memory(struct engine *e, uint32_t address, uint32_t size);
bool engine_cached(const struct engine *e, uint32_t address);

#define TIME_HZ UINT64_C(216000000)
#define NEVER UINT64_MAX
#define DTCM_BASE 0x20000000u
#define SRAM_BASE 0x20010000u /* SRAM1 and SRAM2, which may be cached */
#define SRAM_END 0x20040000u

enum {
	WINDOWS = 128,
	SLOTS = 256,
	DEVICES = 15,
	PORTS = 4,
	STREAMS = 8,
	TIMERS = 6,
	CHANNELS = 4,
	SOURCES = 64,
	SHARED = 3,           /* requests that may share a place */
	FIFO_BYTES = 4,
	STEADY_PERIODS = 20,
	PERIODS = 512,        /* handled at once */
	TRAIN = 16,           /* the bits of a DShot frame */
	FRAMES = 256,         /* kept for Python */
	GAP = 432,            /* least rest before a frame: 2 us [cycles] */
	DRAIN = SOURCES,      /* in place of a source: Python is to take the frames */
	PYTHON_SOURCE = 32,   /* sources from here on are Python's */
};

enum kind { COLD, PORT, SYSCFG, EXTI, DMA, SPI, TIMER };
enum source { SPI_RX, SPI_TX, TIMER_SOURCE }; /* then five a timer: update, channels 1 to 4 */

/* What Python is asked to judge; it raises what is wrong. */
enum question {
	ASK_ENABLE,   /* controller, stream: is about to be enabled; sets its sources */
	ASK_CHANGED,  /* controller, stream, new value: changed while enabled */
	ASK_FROZEN,   /* controller, stream, slot: written while enabled */
	ASK_TWICE,    /* controller, stream, source: another stream serves it */
	ASK_CACHED,   /* controller, stream, address */
	ASK_SPI,      /* is about to send */
	ASK_SPI_BUSY, /* CR1 changed meanwhile */
	ASK_SPI_FULL, /* DR written into a full FIFO */
	ASK_OUTPUT,   /* timer, channel: makes pulses */
	ASK_TARGET,   /* timer, source: feeds no register that it may */
	ASK_COMPARE,  /* timer, source: asks at compare */
	ASK_DMAR,     /* timer, write: DMAR by the program */
	ASK_ASLEEP,   /* controller, stream: reads DTCM while the core sleeps */
};

struct rule {
	uint32_t reset, fixed, writable;
	uint8_t known, sizes, readable, writeable;
};

typedef uint32_t (*read_function)(uint32_t window, uint32_t offset, uint32_t size);
typedef void (*write_function)(uint32_t window, uint32_t offset, uint32_t size, uint32_t value);
typedef void (*alarm_function)(uint32_t alarm);
typedef void (*refuse_function)(uint32_t window, uint32_t offset, uint32_t size, uint32_t value, uint32_t write);
typedef int (*judge_function)(uint32_t question, uint32_t a, uint32_t b, uint32_t c);
typedef void (*source_function)(uint32_t source, uint32_t sync);
typedef void (*exchange_function)(uint8_t *bytes, uint32_t count, uint32_t transaction, double hz, uint32_t mode);
typedef void (*pulses_function)(uint32_t timer, uint32_t channel, uint64_t start, uint64_t length, uint32_t count,
				const uint32_t *highs);
typedef void (*pin_function)(uint32_t port, uint32_t pin, uint32_t level);

struct stream {
	uint32_t total, moved;
	int32_t sources[SHARED];             /* that drive it while it is enabled, -1: none */
	int32_t judged[SHARED];              /* those of the set-up judged last */
	uint32_t cr, par, m0ar, ndtr, epoch; /* that set-up; epoch 0: none yet */
};

/* Pulses of a channel that have not been shown yet: what lies between two rests of the line. */
struct train {
	uint64_t start, length;
	uint32_t count, highs[TRAIN];
};

/* What is known of the ESC on a channel. Python decodes whatever does not fit this, and the first frame. */
struct esc {
	uint64_t rest_since;      /* end of the last frame */
	uint32_t shortest, longest; /* of a bit [cycles]; longest 0: nothing is known yet */
};

struct frame {
	uint64_t cycle;
	uint32_t timer, channel, data; /* data: value and telemetry bit */
};

struct timer {
	uint64_t anchor;
	uint32_t ccr[CHANNELS], arr, psc;
	uint32_t stopped_at, pending, steady;
	uint32_t judged[CHANNELS]; /* epoch in which the output was found right */
	uint32_t ccmr[CHANNELS];   /* of its register then */
	struct train trains[CHANNELS];
	struct esc escs[CHANNELS];
};

struct hot_state {
	uint32_t words[DEVICES][SLOTS];
	uint64_t reads[DEVICES][SLOTS], writes[DEVICES][SLOTS];
	uint8_t clocked[DEVICES];
	uint16_t driven[PORTS], high[PORTS], told[PORTS];
	uint32_t exti_asserted;
	struct stream streams[2][STREAMS];
	int16_t stream_of[SOURCES];
	struct timer timers[TIMERS];
	uint8_t sending[FIFO_BYTES + 1], received[FIFO_BYTES];
	uint32_t sending_count, received_count, last;
	uint64_t begun; /* NEVER: no byte is on the wire */
	uint32_t overrun, spi_epoch, spi_cr1, spi_cr2;
	uint32_t selected, transaction;
	uint64_t apb2, timer_clock[2];
	struct frame frames[FRAMES];
	uint32_t frame_count;
	uint32_t epoch; /* rises with what judgements depend on: pins, clocks of peripherals */
};

struct hot {
	struct hot_state s;
	struct engine *e;
	read_function on_read;
	write_function on_write;
	alarm_function on_alarm;
	refuse_function refuse;
	judge_function judge;
	source_function source;
	exchange_function exchange;
	pulses_function pulses;
	pin_function pin;
	struct rule rules[DEVICES][SLOTS];
	uint8_t kinds[DEVICES], numbers[DEVICES]; /* number: among its kind */
	int16_t device_of[WINDOWS];
	uint32_t ports[PORTS], controllers[2], timer_devices[TIMERS], spi, exti, syscfg; /* devices */
	uint32_t bases[DEVICES];
	uint32_t irqs[DEVICES][STREAMS];
	uint32_t alarms[DEVICES];
	uint8_t advanced[TIMERS];
	uint16_t watched[PORTS];
	uint64_t lazy; /* sources of Python whose drivers have something to bring up to now */
	bool failed; /* Python has raised during this access */
};

/* The callbacks carry no handle: whoever runs an engine says before which one. */
static _Thread_local struct hot *current;

static uint64_t now(const struct hot *h)
{
	return engine_cycle(h->e);
}

static void ask(struct hot *h, enum question question, uint32_t a, uint32_t b, uint32_t c)
{
	if (h->judge(question, a, b, c) != 0)
		h->failed = true;
}

static uint32_t *words(struct hot *h, uint32_t device)
{
	return h->s.words[device];
}

/* Keeps the writable bits; returns those that changed. */
static uint32_t keep(struct hot *h, uint32_t device, uint32_t slot, uint32_t value)
{
	const uint32_t writable = h->rules[device][slot].writable;
	uint32_t *const word = &h->s.words[device][slot];
	const uint32_t before = *word;

	*word = (before & ~writable) | (value & writable);
	return before ^ *word;
}

/* ---- EXTI ---- */

enum { EXTI_IMR = 0, EXTI_RTSR = 2, EXTI_FTSR = 3, EXTI_SWIER = 4, EXTI_PR = 5 };

static void exti_update(struct hot *h)
{
	static const uint32_t lines[STREAMS] = {1u << 0, 1u << 1, 1u << 2, 1u << 3, 1u << 4, 0x03E0u, 0xFC00u, 1u << 16};
	const uint32_t *const w = words(h, h->exti);
	const uint32_t pending = w[EXTI_PR] & w[EXTI_IMR], changed = pending ^ h->s.exti_asserted;

	h->s.exti_asserted = pending;
	for (uint32_t i = 0; changed != 0u && i < STREAMS; ++i)
		if (changed & lines[i])
			engine_irq(h->e, h->irqs[h->exti][i], (pending & lines[i]) != 0u);
}

static void exti_edge(struct hot *h, uint32_t port, uint32_t line, bool rising)
{
	uint32_t *const w = words(h, h->exti);

	if ((w[rising ? EXTI_RTSR : EXTI_FTSR] >> line & 1u) == 0u || !h->s.clocked[h->syscfg])
		return;
	/* EXTICR1 to 4 are words 2 to 5, four bits a line. */
	if ((words(h, h->syscfg)[2u + line / 4u] >> 4u * (line % 4u) & 15u) != port)
		return;
	w[EXTI_PR] |= 1u << line;
	exti_update(h);
}

static void exti_write(struct hot *h, uint32_t slot, uint32_t value)
{
	uint32_t *const w = words(h, h->exti);

	if (slot == EXTI_PR) {
		w[EXTI_PR] &= ~value;
		w[EXTI_SWIER] &= ~value;
	} else {
		const uint32_t changed = keep(h, h->exti, slot, value);

		if (slot == EXTI_SWIER)
			w[EXTI_PR] |= changed & w[EXTI_SWIER] & w[EXTI_IMR];
	}
	exti_update(h);
}

/* ---- GPIO ---- */

enum { MODER = 0, OTYPER = 1, PUPDR = 3, IDR = 4, ODR = 5, BSRR = 6 };
enum { CS_PORT = 2, CS_PIN = 2 };

static bool pin_level(const struct hot *h, uint32_t port, uint32_t pin)
{
	const uint32_t *const w = h->s.words[h->ports[port]];
	const bool odr = (w[ODR] >> pin & 1u) != 0u;

	if ((w[MODER] >> 2u * pin & 3u) == 1u && !((w[OTYPER] >> pin & 1u) != 0u && odr))
		return odr;
	if (h->s.driven[port] >> pin & 1u)
		return h->s.high[port] >> pin & 1u;
	return (w[PUPDR] >> 2u * pin & 3u) == 1u;
}

static void tell_pins(struct hot *h, uint32_t port)
{
	if (port == CS_PORT) {
		const bool selected = !pin_level(h, CS_PORT, CS_PIN);

		h->s.transaction += selected != h->s.selected;
		h->s.selected = selected;
	}
	for (uint32_t pin = 0; h->watched[port] >> pin != 0u; ++pin) {
		if ((h->watched[port] >> pin & 1u) == 0u)
			continue;
		const bool level = pin_level(h, port, pin);

		if (level != (h->s.told[port] >> pin & 1u)) {
			h->s.told[port] ^= (uint16_t)(1u << pin);
			h->pin(port, pin, level);
		}
	}
}

static uint32_t port_read(struct hot *h, uint32_t device, uint32_t slot)
{
	const uint32_t port = h->numbers[device];
	uint32_t value = 0;

	if (slot != IDR)
		return words(h, device)[slot];
	for (uint32_t pin = 0; pin < 16u; ++pin)
		if ((words(h, device)[MODER] >> 2u * pin & 3u) != 3u)
			value |= (uint32_t)pin_level(h, port, pin) << pin;
	return value;
}

static void port_write(struct hot *h, uint32_t device, uint32_t slot, uint32_t value)
{
	uint32_t *const w = words(h, device);

	if (slot == BSRR)
		w[ODR] = (w[ODR] & ~(value >> 16)) | (value & 0xFFFFu);
	else if (keep(h, device, slot, value) != 0u && slot != ODR)
		++h->s.epoch;
	tell_pins(h, h->numbers[device]);
}

void hot_drive(struct hot *h, uint32_t port, uint32_t pin, bool level)
{
	const uint16_t bit = (uint16_t)(1u << pin);

	if ((h->s.driven[port] & bit) != 0u && ((h->s.high[port] & bit) != 0u) == level)
		return;
	h->s.driven[port] |= bit;
	h->s.high[port] = (uint16_t)(level ? h->s.high[port] | bit : h->s.high[port] & ~bit);
	exti_edge(h, port, pin, level);
	tell_pins(h, port);
}

void hot_pulse(struct hot *h, uint32_t port, uint32_t pin)
{
	hot_drive(h, port, pin, false);
	hot_drive(h, port, pin, true);
}

bool hot_level(struct hot *h, uint32_t port, uint32_t pin)
{
	return pin_level(h, port, pin);
}

void hot_watch(struct hot *h, uint32_t port, uint32_t pin)
{
	h->watched[port] |= (uint16_t)(1u << pin);
	h->s.told[port] = (uint16_t)((h->s.told[port] & ~(1u << pin)) | (uint32_t)pin_level(h, port, pin) << pin);
}

/* ---- DMA ---- */

enum { LISR = 0, HISR = 1, LIFCR = 2, HIFCR = 3 };
enum { S_CR = 4, S_NDTR = 5, S_PAR = 6, S_M0AR = 7, S_STEP = 6 }; /* words of stream 0 */
enum { CR_EN = 1u << 0, CR_DIR = 3u << 6, CR_READS = 1u << 6, CR_CIRC = 1u << 8, CR_MINC = 1u << 10, CR_INTERRUPTS = 0x1Eu };
enum { FLAG_HT = 1u << 4, FLAG_TC = 1u << 5, FLAGS = 0x3Du, FLAGS_WITH_INTERRUPT = 0x3Cu };

static uint64_t byte_cycles(const struct hot *h);
static uint32_t spi_waiting(struct hot *h);
static void spi_sync(struct hot *h);
static void spi_dma_changed(struct hot *h);
static void timer_sync(struct hot *h, uint32_t t);
static void timer_dma_changed(struct hot *h, uint32_t t);

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

static void stream_unlink(struct hot *h, uint32_t controller, uint32_t stream)
{
	struct stream *const s = &h->s.streams[controller][stream];

	for (uint32_t i = 0; i < SHARED; ++i)
		if (s->sources[i] >= 0)
			h->s.stream_of[s->sources[i]] = -1;
	for (uint32_t i = 0; i < SHARED; ++i)
		s->sources[i] = -1;
}

/* The driver of a request brings itself up to now, or hears that a stream came or went. */
static void drive(struct hot *h, int32_t source, bool sync)
{
	if (source < 0)
		return;
	if (source >= PYTHON_SOURCE) {
		if (!sync)
			h->source((uint32_t)source, false); /* flags rise with Python's alarms, without being asked */
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
		h->source((uint32_t)source, true);
	else
		stream_sync(h, controller, stream);
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

static uint32_t dma_read(struct hot *h, uint32_t device, uint32_t slot)
{
	const uint32_t controller = h->numbers[device];

	if (slot == LISR || slot == HISR) {
		for (uint32_t i = 0; i < 4u; ++i)
			stream_sync(h, controller, i + (slot == HISR ? 4u : 0u));
	} else if (slot >= S_CR && (slot - S_CR) % S_STEP == 0u) {
		if (stream_may_have_ended(h, controller, (slot - S_CR) / S_STEP))
			stream_sync(h, controller, (slot - S_CR) / S_STEP);
	} else if (slot >= S_CR && (slot - S_CR) % S_STEP == 1u) {
		drive_for(h, controller, (slot - S_CR) / S_STEP);
	}
	return words(h, device)[slot];
}

static void dma_write(struct hot *h, uint32_t device, uint32_t slot, uint32_t value)
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
	struct hot *const h = current;

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

/* ---- SPI1 ---- */

enum { SPI_CR1 = 0, SPI_CR2 = 1, SPI_SR = 2, SPI_DR = 3 };
enum { SPE = 1u << 6, RXDMAEN = 1u << 0, TXDMAEN = 1u << 1, ERRIE = 1u << 5, RXNEIE = 1u << 6, TXEIE = 1u << 7 };
enum { FRXTH = 1u << 12 };
enum { SR_RXNE = 1u << 0, SR_TXE = 1u << 1, SR_OVR = 1u << 6, SR_BSY = 1u << 7 };

static uint64_t byte_cycles(const struct hot *h)
{
	return 8u * (2u << (h->s.words[h->spi][SPI_CR1] >> 3 & 7u)) * TIME_HZ / h->s.apb2;
}

static uint32_t spi_waiting(struct hot *h)
{
	const uint32_t *const w = words(h, h->spi);

	return (w[SPI_CR1] & SPE) != 0u && (w[SPI_CR2] & TXDMAEN) != 0u ? hot_available(h, SPI_TX) : 0u;
}

/* Bytes in the FIFO, without the one in the shift register. */
static uint32_t spi_level(const struct hot *h)
{
	return h->s.sending_count - (h->s.begun != NEVER && h->s.sending_count != 0u);
}

static uint32_t spi_status(const struct hot *h)
{
	static const uint8_t levels[] = {0, 1, 2, 3, 3, 3};
	const uint32_t level = spi_level(h), enough = h->s.words[h->spi][SPI_CR2] & FRXTH ? 1u : 2u;

	return (h->s.received_count >= enough ? SR_RXNE : 0u) | (level <= FIFO_BYTES / 2 ? SR_TXE : 0u) |
	       (h->s.overrun ? SR_OVR : 0u) | (h->s.begun != NEVER ? SR_BSY : 0u) |
	       (uint32_t)levels[h->s.received_count] << 9 | (uint32_t)levels[level] << 11;
}

static void spi_update(struct hot *h)
{
	const uint32_t status = spi_status(h), enables = words(h, h->spi)[SPI_CR2];

	engine_irq(h->e, h->irqs[h->spi][0],
		   ((status & SR_RXNE) != 0u && (enables & RXNEIE) != 0u) ||
			   ((status & SR_TXE) != 0u && (enables & TXEIE) != 0u) ||
			   ((status & SR_OVR) != 0u && (enables & ERRIE) != 0u));
}

/* Fills the FIFO from memory. */
static void spi_fetch(struct hot *h)
{
	const uint32_t capacity = FIFO_BYTES + (h->s.begun != NEVER);
	uint32_t item;

	while (h->s.sending_count < capacity && spi_waiting(h) != 0u && hot_take(h, SPI_TX, &item, 1) == 1u)
		h->s.sending[h->s.sending_count++] = (uint8_t)item;
}

/* `count` bytes have passed: out, in, and to memory. */
static void spi_exchange(struct hot *h, uint8_t *bytes, uint32_t count)
{
	const uint32_t *const w = words(h, h->spi);
	uint32_t items[PERIODS], given = 0;

	if (h->s.selected) {
		h->exchange(bytes, count, h->s.transaction, (double)h->s.apb2 / (double)(2u << (w[SPI_CR1] >> 3 & 7u)),
			    (w[SPI_CR1] & 1u) | (w[SPI_CR1] & 2u)); /* CPHA, CPOL */
	} else {
		const uint32_t *const port = words(h, h->ports[0]);

		memset(bytes, (port[PUPDR] >> 12 & 3u) == 1u ? 0xFF : 0x00, count); /* MISO is PA6 */
	}
	if (w[SPI_CR2] & RXDMAEN) {
		for (uint32_t i = 0; i < count; ++i)
			items[i] = bytes[i];
		const uint32_t available = hot_available(h, SPI_RX);

		given = hot_give(h, SPI_RX, items, available < count ? available : count);
	}
	for (uint32_t i = given; i < count; ++i) {
		if (h->s.received_count < FIFO_BYTES)
			h->s.received[h->s.received_count++] = bytes[i];
		else
			h->s.overrun = 1;
	}
}

/* Moves up to `passed` bytes; false: the line rests. */
static bool spi_shift(struct hot *h, uint64_t passed)
{
	uint8_t bytes[PERIODS];

	while (passed != 0u && !h->failed) {
		const uint32_t part = passed < PERIODS ? (uint32_t)passed : PERIODS;
		uint32_t count = 0;

		while (count < part && h->s.sending_count != 0u) {
			bytes[count++] = h->s.sending[0];
			memmove(h->s.sending, h->s.sending + 1, --h->s.sending_count);
			spi_fetch(h);
		}
		h->s.begun += count * byte_cycles(h);
		passed -= count;
		spi_exchange(h, bytes, count);
		if (h->s.sending_count == 0u) {
			h->s.begun = NEVER;
			return false;
		}
	}
	return true;
}

static void spi_sync(struct hot *h)
{
	while (h->s.begun != NEVER && !h->failed) {
		const uint64_t passed = (now(h) - h->s.begun) / byte_cycles(h);
		const uint64_t all = h->s.sending_count + spi_waiting(h);

		spi_fetch(h);
		if (passed == 0u || !spi_shift(h, passed < all ? passed : all))
			break;
	}
	if (h->s.begun == NEVER)
		spi_fetch(h);
	spi_update(h);
}

static void spi_plan(struct hot *h)
{
	const uint32_t cr2 = words(h, h->spi)[SPI_CR2];
	uint64_t left = h->s.sending_count + spi_waiting(h);

	if (h->s.begun != NEVER && (cr2 & (RXNEIE | TXEIE)) != 0u)
		left = 1;
	else if (h->s.begun != NEVER && (cr2 & RXDMAEN) != 0u) {
		const uint32_t available = hot_available(h, SPI_RX);

		left = available != 0u && available < left ? available : left;
	} else {
		engine_set_alarm(h->e, h->alarms[h->spi], NEVER);
		return;
	}
	engine_set_alarm(h->e, h->alarms[h->spi], h->s.begun + left * byte_cycles(h));
}

static void spi_start(struct hot *h)
{
	const uint32_t *const w = words(h, h->spi);

	if (h->s.begun == NEVER && (w[SPI_CR1] & SPE) != 0u) {
		spi_fetch(h);
		if (h->s.sending_count != 0u) {
			if (h->s.spi_epoch != h->s.epoch || h->s.spi_cr1 != w[SPI_CR1] || h->s.spi_cr2 != w[SPI_CR2]) {
				ask(h, ASK_SPI, 0, 0, 0);
				if (h->failed)
					return;
				h->s.spi_epoch = h->s.epoch;
				h->s.spi_cr1 = w[SPI_CR1];
				h->s.spi_cr2 = w[SPI_CR2];
			}
			h->s.begun = now(h);
			spi_fetch(h);
		}
	}
	spi_plan(h);
}

static void spi_dma_changed(struct hot *h)
{
	spi_sync(h);
	spi_start(h);
}

static uint32_t spi_read(struct hot *h, uint32_t slot, uint32_t size)
{
	uint32_t value = 0;

	spi_sync(h);
	if (slot == SPI_SR)
		return spi_status(h);
	if (slot != SPI_DR)
		return words(h, h->spi)[slot];
	for (uint32_t i = 0; i < (size < 2u ? size : 2u); ++i) {
		if (h->s.received_count != 0u) {
			h->s.last = h->s.received[0];
			memmove(h->s.received, h->s.received + 1, --h->s.received_count);
		}
		value |= h->s.last << 8u * i;
	}
	h->s.overrun = 0;
	spi_update(h);
	return value;
}

static void spi_write(struct hot *h, uint32_t slot, uint32_t size, uint32_t value)
{
	spi_sync(h);
	if (slot == SPI_CR1) {
		const uint32_t changed = keep(h, h->spi, slot, value);

		if ((changed & SPE) != 0u && (value & SPE) == 0u) {
			h->s.sending_count = 0; /* what is on the wire is lost */
			h->s.begun = NEVER;
		} else if ((changed & ~(uint32_t)SPE) != 0u && h->s.begun != NEVER) {
			ask(h, ASK_SPI_BUSY, 0, 0, 0);
			return;
		}
	} else if (slot == SPI_CR2) {
		keep(h, h->spi, slot, value);
	} else if (slot == SPI_DR) {
		for (uint32_t i = 0; i < (size < 2u ? size : 2u); ++i) {
			if (spi_level(h) >= FIFO_BYTES) {
				ask(h, ASK_SPI_FULL, 0, 0, 0);
				return;
			}
			h->s.sending[h->s.sending_count++] = (uint8_t)(value >> 8u * i);
		}
	} else {
		return;
	}
	spi_start(h);
	spi_update(h);
}

/* ---- timers ---- */

enum { T_CR1 = 0, T_CR2 = 1, T_DIER = 3, T_SR = 4, T_EGR = 5, T_CCMR1 = 6, T_CCMR2 = 7, T_CCER = 8, T_CNT = 9,
       T_PSC = 10, T_ARR = 11, T_CCR1 = 13, T_CCR4 = 16, T_BDTR = 17, T_DCR = 18, T_DMAR = 19 };
enum { CEN = 1u << 0, UDIS = 1u << 1, URS = 1u << 2, OPM = 1u << 3, ARPE = 1u << 7 };
enum { CCDS = 1u << 3, MOE = 1u << 15, UIF = 1u << 0 };

static uint64_t timer_cycles(const struct hot *h, uint32_t t, uint64_t counts)
{
	return counts * (h->s.timers[t].psc + 1u) * TIME_HZ / h->s.timer_clock[h->advanced[t]];
}

static uint64_t timer_period(const struct hot *h, uint32_t t)
{
	return timer_cycles(h, t, (uint64_t)h->s.timers[t].arr + 1u);
}

static uint32_t timer_count(const struct hot *h, uint32_t t)
{
	const struct timer *const s = &h->s.timers[t];

	if ((h->s.words[h->timer_devices[t]][T_CR1] & CEN) == 0u)
		return s->stopped_at;
	const uint64_t count = (now(h) - s->anchor) * h->s.timer_clock[h->advanced[t]] / (TIME_HZ * (s->psc + 1u));

	return count < s->arr ? (uint32_t)count : s->arr;
}

static uint32_t source_of(uint32_t t, uint32_t k)
{
	return TIMER_SOURCE + 5u * t + k;
}

/* Is request `k` (0 update, 1 to 4 channels) made at each update? */
static bool timer_asks(struct hot *h, uint32_t t, uint32_t k)
{
	const uint32_t *const w = words(h, h->timer_devices[t]);

	if ((w[T_DIER] >> (8u + k) & 1u) == 0u)
		return false;
	if (k != 0u && (w[T_CR2] & CCDS) == 0u) {
		ask(h, ASK_COMPARE, t, k, 0);
		return false;
	}
	return true;
}

/* The words that one request writes: first and how many; 0 when it may not. */
static uint32_t timer_target(struct hot *h, uint32_t t, uint32_t k, uint32_t *first)
{
	const uint32_t device = h->timer_devices[t];
	const uint32_t *const w = words(h, device);
	const uint32_t slot = (hot_target(h, source_of(t, k)) - h->bases[device]) >> 2;
	uint32_t count = 1;

	*first = slot;
	if (slot == T_DMAR) {
		*first = w[T_DCR] & 31u;
		count = (w[T_DCR] >> 8 & 31u) + 1u;
	}
	for (uint32_t i = *first; i < *first + count; ++i) {
		if (i != T_PSC && i != T_ARR && (i < T_CCR1 || i > T_CCR4)) {
			ask(h, ASK_TARGET, t, k, 0);
			return 0;
		}
	}
	return count;
}

static bool preloaded(const struct hot *h, uint32_t t, uint32_t channel)
{
	return h->s.words[h->timer_devices[t]][T_CCMR1 + channel / 2u] >> (3u + 8u * (channel % 2u)) & 1u;
}

static void timer_store(struct hot *h, uint32_t t, uint32_t slot, uint32_t value)
{
	keep(h, h->timer_devices[t], slot, value);
	if (slot >= T_CCR1 && slot <= T_CCR4 && !preloaded(h, t, slot - T_CCR1))
		h->s.timers[t].ccr[slot - T_CCR1] = value;
}

static void timer_load(struct hot *h, uint32_t t)
{
	const uint32_t *const w = words(h, h->timer_devices[t]);
	struct timer *const s = &h->s.timers[t];

	s->arr = w[T_ARR];
	s->psc = w[T_PSC];
	memcpy(s->ccr, w + T_CCR1, sizeof s->ccr);
}

static void timer_update_irq(struct hot *h, uint32_t t)
{
	const uint32_t device = h->timer_devices[t];

	engine_irq(h->e, h->irqs[device][0], (words(h, device)[T_SR] & words(h, device)[T_DIER] & UIF) != 0u);
}

/* Takes a train for a DShot frame; false: it is none, or Python has to say what is wrong with it. */
static bool take_frame(struct hot *h, uint32_t t, uint32_t channel, const struct train *train)
{
	struct esc *const esc = &h->s.timers[t].escs[channel];
	const uint64_t length = train->length;
	uint32_t frame = 0;

	if (length < esc->shortest || length > esc->longest || train->start < esc->rest_since + GAP)
		return false;
	for (uint32_t i = 0; i < TRAIN; ++i) {
		/* 37.5 % of the bit for a 0, 75 % for a 1, within 5 % of that: sim/board/dshot.py. */
		const uint64_t high = 8u * (uint64_t)train->highs[i];
		const uint64_t nominal = 16u * (uint64_t)train->highs[i] > 9u * length ? 6u * length : 3u * length;

		if (20u * (high > nominal ? high - nominal : nominal - high) > nominal)
			return false;
		frame = frame << 1 | (nominal == 6u * length);
	}
	const uint32_t data = frame >> 4;

	if ((frame & 15u) != ((data ^ data >> 4 ^ data >> 8) & 15u))
		return false;
	if (h->s.frame_count == FRAMES)
		h->source(DRAIN, 0);
	if (h->s.frame_count == FRAMES)
		return false;
	esc->rest_since = train->start + TRAIN * length;
	h->s.frames[h->s.frame_count++] = (struct frame){
		.cycle = esc->rest_since, .timer = t, .channel = channel + 1u, .data = data,
	};
	return true;
}

/* One period more of a channel. Python sees trains as a whole: up to a rest, or as long as a frame can be. */
static void timer_show(struct hot *h, uint32_t t, uint32_t channel, uint64_t start, uint32_t high)
{
	struct train *const train = &h->s.timers[t].trains[channel];
	const uint64_t length = timer_period(h, t);

	if (train->count != 0u && (train->length != length || train->start + train->count * length != start)) {
		h->pulses(t, channel + 1u, train->start, train->length, train->count, train->highs);
		train->count = 0;
	}
	if (train->count == 0u) {
		if (high == 0u)
			return;
		train->start = start;
		train->length = length;
	}
	train->highs[train->count++] = high;
	if (high == 0u || train->count == TRAIN) {
		if (high == 0u || !take_frame(h, t, channel, train))
			h->pulses(t, channel + 1u, train->start, length, train->count, train->highs);
		train->count = 0;
	}
}

/* Periods of a channel that have passed, the first `offset` periods after the anchor. */
static void timer_pulses(struct hot *h, uint32_t t, uint32_t channel, uint32_t offset, uint32_t count,
			 const uint32_t *compares)
{
	const uint32_t *const w = words(h, h->timer_devices[t]);
	struct timer *const s = &h->s.timers[t];
	uint32_t highs[PERIODS];
	bool any = false;

	if (count == 0u || (h->advanced[t] && (w[T_BDTR] & MOE) == 0u) || (w[T_CCER] >> 4u * channel & 1u) == 0u)
		return;
	for (uint32_t i = 0; i < count; ++i) {
		highs[i] = (uint32_t)timer_cycles(h, t, compares[i]);
		any = any || compares[i] != 0u;
	}
	if (any && (s->judged[channel] != h->s.epoch || s->ccmr[channel] != w[T_CCMR1 + channel / 2u])) {
		ask(h, ASK_OUTPUT, t, channel + 1u, 0);
		if (h->failed)
			return;
		s->judged[channel] = h->s.epoch;
		s->ccmr[channel] = w[T_CCMR1 + channel / 2u];
	}
	for (uint32_t i = 0; i < count; ++i)
		timer_show(h, t, channel, s->anchor + (offset + i) * timer_period(h, t), highs[i]);
}

/* One request's items go to their registers. */
static void timer_feed(struct hot *h, uint32_t t, uint32_t k)
{
	uint32_t first, items[32];
	const uint32_t count = timer_target(h, t, k, &first);
	const uint32_t available = hot_available(h, source_of(t, k));
	const uint32_t taken = hot_take(h, source_of(t, k), items, count < available ? count : available);

	for (uint32_t i = 0; i < taken; ++i)
		timer_store(h, t, first + i, items[i]);
	h->s.timers[t].steady = 0;
}

/* `updates` updates, at each of which a period ends and DMA writes the compare values of the next. */
static uint32_t timer_run_fed(struct hot *h, uint32_t t, uint32_t k, uint64_t updates)
{
	uint32_t compares[CHANNELS][PERIODS];
	uint32_t first, done = 0;
	const uint32_t step = timer_target(h, t, k, &first);

	if (step == 0u)
		return 1;
	while (done < updates && done < PERIODS && hot_available(h, source_of(t, k)) != 0u && !h->failed) {
		for (uint32_t c = 0; c < CHANNELS; ++c)
			compares[c][done] = h->s.timers[t].ccr[c];
		timer_load(h, t);
		timer_feed(h, t, k);
		++done;
		if (h->s.timers[t].arr != words(h, h->timer_devices[t])[T_ARR])
			break;
	}
	for (uint32_t c = 0; c < CHANNELS; ++c)
		timer_pulses(h, t, c, 0, done, compares[c]);
	return done;
}

/* Nothing changes from update to update; an endless pulse train is shown for a while. */
static uint64_t timer_free_run(struct hot *h, uint32_t t, uint64_t updates)
{
	struct timer *const s = &h->s.timers[t];
	uint32_t compares[STEADY_PERIODS];

	if (s->steady)
		return updates;
	if ((s->ccr[0] | s->ccr[1] | s->ccr[2] | s->ccr[3]) == 0u) {
		for (uint32_t c = 0; updates > 1u && c < CHANNELS; ++c)
			if (s->trains[c].count != 0u)
				timer_show(h, t, c, s->anchor + timer_period(h, t), 0);
		return updates;
	}
	const uint32_t shown = updates - 1u < STEADY_PERIODS ? (uint32_t)(updates - 1u) : STEADY_PERIODS;

	for (uint32_t c = 0; c < CHANNELS; ++c) {
		for (uint32_t i = 0; i < shown; ++i)
			compares[i] = s->ccr[c];
		timer_pulses(h, t, c, 1, shown, compares);
	}
	s->steady = shown == STEADY_PERIODS;
	return 1u + shown;
}

/* Goes through `updates` updates or fewer; returns how many. */
static uint64_t timer_run(struct hot *h, uint32_t t, uint64_t updates)
{
	uint32_t *const w = words(h, h->timer_devices[t]);
	struct timer *const s = &h->s.timers[t];
	uint32_t asking = 0, fed = 0, fed_count = 0, last = 0;
	uint64_t count = 1;

	for (uint32_t k = 0; k <= CHANNELS; ++k) {
		if (!timer_asks(h, t, k))
			continue;
		asking |= 1u << k;
		if (hot_available(h, source_of(t, k)) != 0u) {
			fed |= 1u << k;
			last = k;
			++fed_count;
		}
	}
	w[T_SR] |= UIF;
	if (fed_count == 1u && w[T_ARR] == s->arr && w[T_PSC] == s->psc) {
		count = timer_run_fed(h, t, last, updates);
	} else {
		for (uint32_t c = 0; c < CHANNELS; ++c)
			timer_pulses(h, t, c, 0, 1, &s->ccr[c]);
		const uint64_t length = timer_period(h, t);

		timer_load(h, t);
		if (fed == 0u && timer_period(h, t) == length)
			count = timer_free_run(h, t, updates);
		for (uint32_t k = 0; k <= CHANNELS; ++k)
			if (fed >> k & 1u)
				timer_feed(h, t, k);
	}
	s->pending |= asking & ~fed;
	timer_update_irq(h, t);
	return count;
}

static void timer_sync(struct hot *h, uint32_t t)
{
	uint32_t *const w = words(h, h->timer_devices[t]);
	struct timer *const s = &h->s.timers[t];

	if ((w[T_CR1] & (CEN | UDIS)) != CEN)
		return;
	uint64_t length = timer_period(h, t), updates = (now(h) - s->anchor) / length;

	while (updates != 0u && !h->failed) {
		if (w[T_CR1] & OPM)
			updates = 1;
		s->anchor += timer_run(h, t, updates) * length;
		if (w[T_CR1] & OPM) {
			w[T_CR1] &= ~(uint32_t)CEN;
			s->stopped_at = 0;
			break;
		}
		length = timer_period(h, t); /* ARR or PSC may be others now */
		updates = now(h) < s->anchor ? 0u : (now(h) - s->anchor) / length;
	}
}

/* The alarm for the next update that somebody waits for. */
static void timer_plan(struct hot *h, uint32_t t)
{
	const uint32_t device = h->timer_devices[t];
	const uint32_t *const w = words(h, device);
	uint64_t waits = NEVER;

	if ((w[T_CR1] & (CEN | UDIS)) == CEN) {
		if (w[T_DIER] & 1u)
			waits = 1;
		for (uint32_t k = 0; k <= CHANNELS && !h->failed; ++k) {
			uint32_t first;
			const uint32_t available = timer_asks(h, t, k) ? hot_available(h, source_of(t, k)) : 0u;
			const uint32_t step = available != 0u ? timer_target(h, t, k, &first) : 0u;

			if (step != 0u && (available + step - 1u) / step < waits)
				waits = (available + step - 1u) / step;
		}
	}
	engine_set_alarm(h->e, h->alarms[device],
			 waits == NEVER ? NEVER : h->s.timers[t].anchor + waits * timer_period(h, t));
}

static void timer_dma_changed(struct hot *h, uint32_t t)
{
	timer_sync(h, t);
	for (uint32_t k = 0; k <= CHANNELS; ++k) {
		if ((h->s.timers[t].pending >> k & 1u) != 0u && hot_available(h, source_of(t, k)) != 0u) {
			h->s.timers[t].pending &= ~(1u << k);
			timer_feed(h, t, k);
		}
	}
	timer_plan(h, t);
}

static uint32_t timer_read(struct hot *h, uint32_t device, uint32_t slot)
{
	const uint32_t t = h->numbers[device];
	uint32_t *const w = words(h, device);

	if (slot == T_DMAR) {
		ask(h, ASK_DMAR, t, 0, 0);
		return 0;
	}
	if (slot != T_CNT && slot != T_SR && slot != T_CR1 && (slot < T_CCR1 || slot > T_CCR4))
		return w[slot];
	timer_sync(h, t);
	if (slot == T_CNT)
		return timer_count(h, t);
	if (slot == T_SR && (w[T_CR1] & CEN) != 0u)
		for (uint32_t c = 0; c < CHANNELS; ++c)
			if (h->s.timers[t].ccr[c] != 0u && timer_count(h, t) >= h->s.timers[t].ccr[c])
				w[T_SR] |= 2u << c;
	return w[slot];
}

static void timer_generate(struct hot *h, uint32_t t, uint32_t value)
{
	uint32_t *const w = words(h, h->timer_devices[t]);
	struct timer *const s = &h->s.timers[t];

	if (value & 1u) {
		s->anchor = now(h);
		s->stopped_at = 0;
		timer_load(h, t);
		if ((w[T_CR1] & URS) == 0u) {
			w[T_SR] |= UIF;
			for (uint32_t k = 0; k <= CHANNELS; ++k) {
				if (!timer_asks(h, t, k))
					continue;
				if (hot_available(h, source_of(t, k)) != 0u)
					timer_feed(h, t, k);
				else
					s->pending |= 1u << k;
			}
			timer_update_irq(h, t);
		}
	}
	w[T_SR] |= value & 0x1Eu;
}

static void timer_write(struct hot *h, uint32_t device, uint32_t slot, uint32_t value)
{
	const uint32_t t = h->numbers[device];
	struct timer *const s = &h->s.timers[t];
	uint32_t *const w = words(h, device);
	uint32_t count, changed;

	if (slot == T_SR) {
		(void)timer_read(h, device, T_SR);
		w[T_SR] &= value;
		timer_update_irq(h, t);
		return;
	}
	timer_sync(h, t);
	switch (slot) {
	case T_DMAR:
		ask(h, ASK_DMAR, t, 1, 0);
		return;
	case T_EGR:
		timer_generate(h, t, value);
		break;
	case T_CNT:
		s->stopped_at = value;
		s->anchor = now(h) - timer_cycles(h, t, value);
		break;
	case T_CR1:
		count = timer_count(h, t);
		changed = keep(h, device, slot, value);
		if (changed & CEN) {
			if (w[T_CR1] & CEN) {
				s->anchor = now(h) - timer_cycles(h, t, count);
				s->steady = 0;
			} else {
				s->stopped_at = count;
			}
		}
		break;
	default:
		keep(h, device, slot, value);
		if (slot == T_ARR && (w[T_CR1] & ARPE) == 0u)
			s->arr = w[T_ARR];
		if (slot >= T_CCR1 && slot <= T_CCR4 && !preloaded(h, t, slot - T_CCR1))
			s->ccr[slot - T_CCR1] = w[slot];
		if (slot == T_CCER || slot == T_BDTR || (slot >= T_CCR1 && slot <= T_CCR4))
			s->steady = 0;
		if (slot == T_DIER) {
			for (uint32_t k = 0; k <= CHANNELS; ++k)
				if (!timer_asks(h, t, k))
					s->pending &= ~(1u << k);
			timer_update_irq(h, t);
		}
		break;
	}
	timer_plan(h, t);
}

/* ---- the engine's callbacks ---- */

uint32_t hot_read(uint32_t window, uint32_t offset, uint32_t size)
{
	struct hot *const h = current;
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

void hot_write(uint32_t window, uint32_t offset, uint32_t size, uint32_t value)
{
	struct hot *const h = current;
	const int16_t device = h->device_of[window];

	if (device < 0) {
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
	struct hot *const h = current;

	h->failed = false;
	if (alarm == h->alarms[h->spi]) {
		spi_sync(h);
		spi_start(h);
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
	h->s.epoch = 1;
	h->s.apb2 = h->s.timer_clock[0] = h->s.timer_clock[1] = 16000000;
	for (uint32_t i = 0; i < WINDOWS; ++i)
		h->device_of[i] = -1;
	for (uint32_t i = 0; i < SOURCES; ++i)
		h->s.stream_of[i] = -1;
	for (uint32_t i = 0; i < 2u * STREAMS; ++i)
		for (uint32_t k = 0; k < SHARED; ++k)
			h->s.streams[i / STREAMS][i % STREAMS].sources[k] = -1;
	return h;
}

void hot_free(struct hot *h)
{
	if (current == h)
		current = NULL;
	free(h);
}

/* The callbacks that follow are of the engine that `h` belongs to. */
void hot_select(struct hot *h)
{
	current = h;
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

/* What Python has found out about an ESC; `longest` 0: nothing. */
void hot_esc(struct hot *h, uint32_t t, uint32_t channel, uint64_t rest_since, uint32_t shortest, uint32_t longest)
{
	h->s.timers[t].escs[channel - 1u] = (struct esc){rest_since, shortest, longest};
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
