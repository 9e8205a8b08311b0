/* The peripherals that a flight controller uses ten thousand times a second, between the engine and Python: GPIO,
 * SYSCFG, EXTI, DMA1 and 2, SPI1 to SPI3, the timers, and what hangs on them: gyro chip, ESCs and watchdog. This
 * file has the types that they share. C moves registers, data and time; the classes of the same names in Python know the
 * rules: C asks them once for each new set-up, and they say what is wrong. */
#ifndef NATIVE_H
#define NATIVE_H

#include <stddef.h>

#include "api.h"

#define DTCM_BASE 0x20000000u
#define SRAM_BASE 0x20010000u /* SRAM1 and SRAM2, which may be cached */
#define SRAM_END 0x20040000u

enum {
	NO_PORT = 0xFF,
	WINDOWS = 128,
	WORDS = 256,
	DEVICES = 20,
	PORTS = 5,            /* A to E */
	PINS = 16,            /* of a port */
	STREAMS = 8,
	SPIS = 3,
	CHIPS = 8,            /* on all SPIs */
	TIMERS = 6,
	CHANNELS = 4,
	MOTORS = 8,
	SOURCES = 64,
	SHARED = 3,           /* requests that may share a place */
	SETUPS = 2,           /* of a stream: frames to the motors and answers from them take turns */
	FIFO_BYTES = 4,
	PERIODS = 512,        /* handled at once */
	FRAMES = 256,         /* kept until Python is told */
};

/* A set-up of a stream that was found right; epoch 0: none yet. */
struct setup {
	int32_t sources[SHARED]; /* that drive it, -1: none */
	uint32_t cr, par, m0ar, ndtr, epoch;
};

struct stream {
	uint32_t total, moved;
	int32_t sources[SHARED]; /* that drive it while it is enabled, -1: none */
	struct setup setups[SETUPS];
	uint32_t latest; /* of them; the one that Python answers for */
};

struct timer {
	uint64_t anchor;
	uint32_t ccr[CHANNELS], arr, psc;
	uint32_t stopped_at, pending;
	uint64_t served;      /* cycle until which requests have been made */
	uint32_t feeds_ports; /* a stream between a port and memory waits for one of its requests, or has */
};

struct spi {
	uint8_t sending[FIFO_BYTES + 1], received[FIFO_BYTES];
	uint32_t sending_count, received_count, last;
	uint64_t begun; /* NEVER: no byte is on the wire */
	uint32_t overrun, epoch, cr1, cr2; /* the last three: of the set-up found right last */
	uint64_t clock; /* of its bus [Hz] */
};

/* A chip behind an SPI; every edge of its select begins a new transaction. */
struct chip {
	uint32_t selected, transaction;
};

/* Where it sits. */
struct place {
	uint8_t kind, spi, port, pin; /* of its select */
};

struct pin {
	uint8_t port, pin;
};

struct native_state {
	uint32_t words[DEVICES][WORDS];
	uint64_t reads[DEVICES][WORDS], writes[DEVICES][WORDS];
	uint8_t clocked[DEVICES];
	uint16_t driven[PORTS], high[PORTS], told[PORTS];
	uint32_t exti_asserted;
	struct stream streams[2][STREAMS];
	int16_t stream_of[SOURCES];
	uint32_t source_alarms[SOURCES];
	uint64_t quiet; /* sources of Python whose moves only a read of registers could show */
	uint64_t due[SOURCES]; /* of Python's sources: cycle at which there is something to move; NEVER: nothing */
	struct timer timers[TIMERS];
	struct spi spis[SPIS];
	struct chip chips[CHIPS];
	struct esc escs[MOTORS];
	uint64_t timer_clock[2];
	struct gyro gyro;
	struct card card;
	struct watchdog watchdog;
	struct frame frames[FRAMES];
	uint32_t frame_count;
	uint32_t epoch; /* rises with what answers to queries depend on: pins, clocks of peripherals */
};

struct native;

/* A peripheral in C that makes DMA requests. */
struct driver {
	void (*sync)(struct native *n, uint32_t source);    /* it moves what it has until now */
	void (*changed)(struct native *n, uint32_t source); /* a stream for it came or went */
	/* Can what has passed have ended the stream? NULL: always. */
	bool (*may_have_ended)(struct native *n, uint32_t source);
};

struct native {
	struct native_state s;
	struct engine *e;
	struct callbacks python; /* of the engine, for what is not C's */
	struct native_callbacks callbacks;
	const struct driver *drivers[PYTHON_SOURCE];
	struct rule rules[DEVICES][WORDS];
	uint8_t kinds[DEVICES], numbers[DEVICES]; /* number: among its kind */
	int16_t device_of[WINDOWS];
	uint32_t device_count;
	uint32_t devices[KINDS][STREAMS]; /* by their kind and number */
	uint32_t bases[DEVICES];
	uint32_t irqs[DEVICES][STREAMS];
	uint32_t alarms[DEVICES];
	uint8_t advanced[TIMERS];
	uint16_t watched[PORTS];
	uint8_t chip_select[PORTS]; /* a chip is selected by one of its pins */
	struct place places[CHIPS];
	uint32_t chip_count, gyro_chip, log_chip; /* the latter: places, or CHIPS */
	struct pin miso[SPIS], ready;             /* port NO_PORT: not wired */
	uint16_t motor_pins[PORTS];               /* with an ESC */
	uint8_t esc_of[PORTS][PINS];              /* there */
	uint32_t motor_count;
	uint32_t watchdog_window, watchdog_offset, watchdog_alarm;
	uint32_t gyro_alarm, gyro_fall_alarm;
	uint64_t gyro_pulse;
	double gyro_data_hz;
	bool samples_heard, frames_heard; /* by Python */
	bool bit_errors, card_fitted;
	uint64_t lazy; /* sources of Python that move between their dues as well */
	bool failed; /* Python has raised during this access */
};

static inline uint64_t native_now(const struct native *n)
{
	return engine_cycle(n->e);
}

static inline void native_query(struct native *n, enum query query, uint32_t device, uint32_t a, uint32_t b)
{
	if (n->callbacks.query(query, device, a, b))
		n->failed = true;
}

static inline uint32_t *device_words(struct native *n, uint32_t device)
{
	return n->s.words[device];
}

/* Keeps the writable bits; returns those that changed. */
static inline uint32_t device_keep(struct native *n, uint32_t device, uint32_t word, uint32_t value)
{
	const uint32_t writable = n->rules[device][word].writable;
	uint32_t *const kept = &n->s.words[device][word];
	const uint32_t before = *kept;

	*kept = (before & ~writable) | (value & writable);
	return before ^ *kept;
}

#endif
