/* The peripherals that a flight controller uses ten thousand times a second, behind the engine's callbacks:
 * GPIO, SYSCFG, EXTI, DMA1 and 2, SPI1 and the timers, each in a file of its own. The classes of the same names in
 * Python say what each does and why; this is the same in C, and the same tests hold both. Python keeps judging: a
 * set-up that has not been seen before is shown to it once, and whatever is wrong is told by it.
 *
 * Of the engine only its public functions are used. */
#ifndef ENGINE_HOT_H
#define ENGINE_HOT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct engine;

uint64_t engine_cycle(const struct engine *e);
void engine_irq(struct engine *e, uint32_t number, bool asserted);
void engine_set_alarm(struct engine *e, uint32_t alarm, uint64_t cycle);
uint64_t engine_due(const struct engine *e, uint32_t alarm);
uint8_t *engine_memory(struct engine *e, uint32_t address, uint32_t size);
bool engine_cached(const struct engine *e, uint32_t address);

#define TIME_HZ UINT64_C(216000000)
#define NEVER UINT64_MAX
#define NO_ADDRESS UINT32_MAX
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
	MOTORS = 8,
	SOURCES = 64,
	SHARED = 3,           /* requests that may share a place */
	FIFO_BYTES = 4,
	STEADY_PERIODS = 20,
	PERIODS = 512,        /* handled at once */
	TRAIN = 16,           /* the bits of a DShot frame */
	FRAMES = 256,         /* kept for Python, if it listens */
	GYRO_VALUES = 7,      /* accelerometer, temperature, gyro */
	GYRO_BYTES = 2 * GYRO_VALUES,
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

/* The ESC on a channel, which Python sees as well. Python decodes whatever does not fit this, and the first frame. */
struct esc {
	int64_t rest_since;         /* end of the last frame */
	uint64_t frames;
	uint64_t last_cycle;        /* of the last frame */
	uint32_t last;              /* its value and telemetry bit; UINT32_MAX: there is none */
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

/* The chip's state, which Python sees as well. */
struct gyro {
	uint64_t due, period;    /* of samples [cycles]; due NEVER: there are none */
	uint64_t samples;
	uint64_t ready_at;       /* before this cycle the chip does not answer */
	uint32_t address;        /* of the next byte, NO_ADDRESS: the next byte is one */
	uint32_t transaction;    /* of the bus */
	int16_t measured[GYRO_VALUES];
	uint8_t data[GYRO_BYTES];
	uint8_t shadow[GYRO_BYTES]; /* data as the transaction sees them */
	uint8_t interrupt, reads, selected;
};

/* The watchdog, which Python sees as well. */
struct watchdog {
	uint64_t period;  /* from a feed to the reset [cycles]; 0: feeding is Python's */
	uint64_t feeds;
	uint64_t closest; /* cycles that were left at the latest feed; NEVER: there was none */
	uint64_t writes;  /* of the key register */
};

struct hot_state {
	uint32_t words[DEVICES][SLOTS];
	uint64_t reads[DEVICES][SLOTS], writes[DEVICES][SLOTS];
	uint8_t clocked[DEVICES];
	uint16_t driven[PORTS], high[PORTS], told[PORTS];
	uint32_t exti_asserted;
	struct stream streams[2][STREAMS];
	int16_t stream_of[SOURCES];
	uint32_t source_alarms[SOURCES];
	uint64_t quiet; /* sources of Python whose moves nobody could notice but by looking */
	uint64_t due[SOURCES]; /* of Python's sources: cycle at which there is something to move; NEVER: nothing */
	struct timer timers[TIMERS];
	uint8_t sending[FIFO_BYTES + 1], received[FIFO_BYTES];
	uint32_t sending_count, received_count, last;
	uint64_t begun; /* NEVER: no byte is on the wire */
	uint32_t overrun, spi_epoch, spi_cr1, spi_cr2;
	uint32_t selected, transaction;
	uint64_t apb2, timer_clock[2];
	struct gyro gyro;
	struct watchdog watchdog;
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
	uint32_t watchdog_window, watchdog_offset, watchdog_alarm;
	uint32_t gyro_alarm, gyro_fall_alarm;
	uint64_t gyro_pulse;
	double gyro_data_hz;
	bool gyro_samples, gyro_answers; /* they are plain: C's */
	const struct esc *motors[MOTORS];
	bool listening; /* Python wants to hear of every frame */
	uint64_t lazy; /* sources of Python that move between their dues as well */
	bool failed; /* Python has raised during this access */
};

/* The callbacks carry no handle: whoever runs an engine says before which one. */
extern _Thread_local struct hot *hot_current;

static inline uint64_t now(const struct hot *h)
{
	return engine_cycle(h->e);
}

static inline void ask(struct hot *h, enum question question, uint32_t a, uint32_t b, uint32_t c)
{
	if (h->judge(question, a, b, c) != 0)
		h->failed = true;
}

static inline uint32_t *words(struct hot *h, uint32_t device)
{
	return h->s.words[device];
}

/* Keeps the writable bits; returns those that changed. */
static inline uint32_t keep(struct hot *h, uint32_t device, uint32_t slot, uint32_t value)
{
	const uint32_t writable = h->rules[device][slot].writable;
	uint32_t *const word = &h->s.words[device][slot];
	const uint32_t before = *word;

	*word = (before & ~writable) | (value & writable);
	return before ^ *word;
}

/* pins.c */
enum { MODER = 0, OTYPER = 1, PUPDR = 3, IDR = 4, ODR = 5, BSRR = 6 }; /* words of GPIO */
void exti_update(struct hot *h);
bool exti_watches_fall(const struct hot *h, uint32_t line);
void exti_write(struct hot *h, uint32_t slot, uint32_t value);
void tell_pins(struct hot *h, uint32_t port);
void hot_pulse(struct hot *h, uint32_t port, uint32_t pin);
uint32_t port_read(struct hot *h, uint32_t device, uint32_t slot);
void port_write(struct hot *h, uint32_t device, uint32_t slot, uint32_t value);

/* dma.c */
void stream_unlink(struct hot *h, uint32_t controller, uint32_t stream);
uint32_t dma_read(struct hot *h, uint32_t device, uint32_t slot);
void dma_write(struct hot *h, uint32_t device, uint32_t slot, uint32_t value);
uint32_t hot_available(struct hot *h, uint32_t source); /* items until the stream ends or begins anew */
uint32_t hot_target(struct hot *h, uint32_t source);    /* peripheral address */
uint32_t hot_take(struct hot *h, uint32_t source, uint32_t *items, uint32_t count);
uint32_t hot_give(struct hot *h, uint32_t source, uint32_t *items, uint32_t count);

/* spi.c */
enum { SPI_CR1 = 0, SPI_CR2 = 1, SPI_SR = 2, SPI_DR = 3 }; /* words */
uint64_t byte_cycles(const struct hot *h);
uint32_t spi_waiting(struct hot *h);                    /* bytes in memory */
void spi_sync(struct hot *h);
void spi_plan(struct hot *h);
void spi_start(struct hot *h);
void spi_dma_changed(struct hot *h);
uint32_t spi_read(struct hot *h, uint32_t slot, uint32_t size);
void spi_write(struct hot *h, uint32_t slot, uint32_t size, uint32_t value);

/* gyro_chip.c */
void gyro_sample(struct hot *h);
/* Bytes of a transaction, answered in place; false: Python is to answer. */
bool gyro_exchange(struct hot *h, uint8_t *bytes, uint32_t count, double hz, uint32_t mode);

/* timer.c */
uint64_t timer_cycles(const struct hot *h, uint32_t t, uint64_t counts);
uint32_t timer_count(const struct hot *h, uint32_t t);
void timer_load(struct hot *h, uint32_t t);
void timer_sync(struct hot *h, uint32_t t);
void timer_plan(struct hot *h, uint32_t t);             /* the alarm for the next update that somebody waits for */
void timer_dma_changed(struct hot *h, uint32_t t);
uint32_t timer_read(struct hot *h, uint32_t device, uint32_t slot);
void timer_write(struct hot *h, uint32_t device, uint32_t slot, uint32_t value);

#endif
