/* What Python calls of the native peripherals (native/library.py), and what both sides share. Python reads this file as
 * it stands, behind the engine's api.h: plain declarations only; it skips the lines that begin with #. */
#ifndef NATIVE_API_H
#define NATIVE_API_H

#include "../../core/c/base/api.h"

enum {
	NO_ADDRESS = 0xFFFFFFFF,
	NO_FRAME = 0xFFFFFFFF,
	PYTHON_SOURCE = 36, /* sources from here on are Python's */
	GYRO_VALUES = 7,    /* accelerometer, temperature, gyro */
	GYRO_BYTES = 14,
	GYRO_WINDOW = 40,   /* registers that C tells: entries are places in the data, */
	GYRO_STATUS = 0x200, /* this, */
	GYRO_VALUE = 0x100,  /* or values beside this bit */
	ESC_EDGES = 32,     /* of a frame: 16 pulses */
	ESC_KINDS = 7,      /* of extended telemetry */
	ANSWER_EDGES = 22,  /* of an answer at most: it begins, 20 bits, it ends */
	NO_ANSWER = 0xFFFF, /* of an ESC: it stays silent */
};

enum chip_kind { CHIP_ABSENT, CHIP_GYRO, CHIP_LOG }; /* an empty place; the gyro chip; the chip that keeps logs */
enum stuck { STUCK_NOT, STUCK_LOW, STUCK_HIGH };     /* an ESC's line while it is not driven */
enum kind { PORT, SYSCFG, EXTI, DMA, SPI, TIMER, KINDS };
enum source { SPI1_RX, SPI1_TX, SPI2_RX, SPI2_TX, SPI3_RX, SPI3_TX, TIMER_SOURCE }; /* then five a timer: update, channels 1 to 4 */

/* What C asks the class of a device, which raises an error for what is wrong. */
enum query {
	QUERY_ENABLE,   /* DMA; stream: is about to be enabled; sets its sources */
	QUERY_CHANGED,  /* DMA; stream, new value: changed while enabled */
	QUERY_FROZEN,   /* DMA; stream, word: written while enabled */
	QUERY_TWICE,    /* DMA; stream, source: another stream serves it */
	QUERY_CACHED,   /* DMA; stream, address */
	QUERY_ASLEEP,   /* DMA; stream: reads DTCM while the core sleeps */
	QUERY_BARRIER,  /* DMA; stream: is enabled by a program that has stored since its last barrier */
	QUERY_SEND,     /* SPI: is about to send */
	QUERY_BUSY,     /* SPI: CR1 changed meanwhile */
	QUERY_FULL,     /* SPI: DR written into a full FIFO */
	QUERY_SELECTED, /* SPI; pins of two chips, port << 4 | number: both are selected */
	QUERY_OUTPUT,   /* timer; outputs: they are enabled, else a burst is written */
	QUERY_DRIVEN,   /* port; pin, cycles since the motor's frame: driven by the program and by an ESC */
};

/* How the program may access a register. */
struct rule {
	uint32_t reset, fixed, writable;
	uint8_t known, sizes, readable, writeable;
};

/* The ESC on a pin. Python decodes whatever is no plain frame, and the first one. */
struct esc {
	int64_t rest_since;         /* end of the last frame */
	uint64_t frames;
	uint64_t last_cycle;        /* of the last frame */
	uint32_t last;              /* its value and telemetry bit, or NO_FRAME */
	uint32_t protocol;          /* 150, 300 or 600; 0: whatever the first frame says */
	uint32_t shortest, longest; /* of a bit [cycles]; longest 0: nothing is known yet */
	uint32_t motor;             /* from 0 */
	uint8_t port, pin;
	uint8_t inverted;           /* the line rests high: bidirectional; known with the protocol */
	uint8_t level, rest;        /* of the line, without what the ESC drives: now, and before the pulses under way */
	uint8_t output;             /* the program drives the pin, */
	uint64_t output_since;      /* or does not, since then */
	uint32_t edge_count;        /* of a frame that is not complete yet */
	uint64_t edges[ESC_EDGES];
	/* Its answer to a bidirectional frame, as it is set: */
	uint16_t answer;            /* word of 12 bits, or NO_ANSWER */
	uint8_t stuck;              /* enum stuck */
	/* Its extended telemetry: asked for so often in a row; on; other answers since the last, and the kind that follows; bit
	 * field of the kinds that it has; their words. */
	uint8_t asked, extended, others, kind, kinds;
	uint16_t told[ESC_KINDS];
	uint32_t delay, jitter;     /* from the frame's end; of each edge at most, to both sides [cycles] */
	double bit_factor;          /* of its clock: 1.01 is 1 % slow */
	double noise, silence;      /* share of samples that are wrong; of frames that are not answered */
	uint64_t random;
	/* and the latest one: */
	uint64_t answers, answer_end;
	uint32_t answer_edge_count; /* the first one falls */
	uint64_t answer_edges[ANSWER_EDGES];
};

struct frame {
	uint64_t cycle;
	uint32_t motor, data; /* data: value and telemetry bit */
};

struct gyro {
	uint64_t due, period;   /* of samples [cycles]; due NEVER: there are none */
	uint64_t samples;
	uint64_t ready_at;      /* before this cycle the chip does not answer */
	uint32_t address, first; /* of the next byte, NO_ADDRESS: the next byte is one; of the transaction's first */
	uint32_t transaction;   /* of the bus, the last one that the chip took part in */
	int16_t measured[GYRO_VALUES];
	uint8_t data[GYRO_BYTES];
	uint8_t shadow[GYRO_BYTES]; /* data as the transaction sees them */
	int8_t gyro_shift, accel_shift; /* full scale above the one that is set, as a power of two; negative: below */
	uint8_t interrupt, reads;
	uint8_t silent;         /* no data-ready pulses, as injected by a fault campaign */
	uint8_t data_at;        /* the first register of the data */
	uint8_t order[GYRO_VALUES]; /* places in `measured` of the values, in the order of the data */
	uint8_t little;         /* a value's lower byte comes first */
	uint8_t hidden;         /* other registers are at the data's addresses now, or it listens to another bus */
	uint8_t window_at, window_count; /* the registers around the data, first and how many */
	uint16_t window[GYRO_WINDOW];
	uint8_t ready_bit;      /* of the status, which a read clears */
	uint8_t dummies, dummies_left; /* bytes of a read before the first that tells something; of this read */
};

/* What the SD card answers while nothing but 0xFF is sent: C does not ask Python for it until `until`. */
struct card {
	uint64_t until;       /* of the last bit of the answer [cycle]; 0: Python is asked for every byte */
	uint32_t transaction; /* of the bus, for which that holds */
	uint8_t answer;
};

struct watchdog {
	uint64_t period;  /* from a feed to the reset [cycles]; 0: it stands */
	uint64_t feeds;
	uint64_t closest; /* cycles that were left at the latest feed; NEVER: there was none */
	uint64_t writes;  /* of the key register */
	uint8_t unlocked;
};

/* What C calls of Python. They never unwind: a failure is kept by Python, and reported by engine_fail. */
typedef void (*reject_callback)(uint32_t device, uint32_t offset, uint32_t size, uint32_t value, bool write);
typedef bool (*query_callback)(uint32_t query, uint32_t device, uint32_t a, uint32_t b); /* true: it has failed */
typedef void (*source_callback)(uint32_t source, bool sync);
typedef void (*exchange_callback)(uint8_t *bytes, uint32_t count, uint32_t transaction, double hz, uint32_t mode);
/* Of the bytes, the first begins at `cycle`, and each lasts `length` cycles at `hz`. */
typedef void (*card_callback)(uint8_t *bytes, uint32_t count, uint64_t cycle, uint32_t length, double hz, uint32_t mode);
typedef void (*errors_callback)(uint8_t *bytes, uint32_t count);
typedef void (*train_callback)(uint32_t motor, uint32_t count, const uint64_t *edges, bool rest);
typedef void (*frames_callback)(const struct frame *frames, uint32_t count);
typedef void (*pin_callback)(uint32_t device, uint32_t pin, bool level);
typedef void (*sample_callback)(uint64_t number);

struct native_callbacks {
	reject_callback reject;     /* an access that a rule forbids */
	query_callback query;
	source_callback source;     /* a driver in Python brings itself up to now, or hears of a stream */
	exchange_callback exchange; /* bytes that C does not answer for the gyro chip */
	card_callback card;         /* bytes between the program and the SD card that C does not answer */
	errors_callback errors;     /* bit errors on received bytes, if there are any */
	train_callback train;       /* edges on a motor's line, that are no plain frame, and the level before them */
	frames_callback frames;     /* frames that C has taken, if asked for */
	pin_callback pin;           /* a watched pin has another level */
	sample_callback sample;     /* the gyro chip is about to sample, if asked for */
};

struct native;

/* Takes the engine's callbacks; `python` gets what is not C's. NULL: no memory. */
struct native *native_new(struct engine *e, const struct callbacks *python, const struct native_callbacks *callbacks);
void native_free(struct native *n);
/* Everything that changes, as plain values: a snapshot copies it. */
void *native_state(struct native *n);
uint32_t native_state_bytes(void);

/* A new device, number `number` among its kind; alarm UINT32_MAX: it has none. Returns the device's number. */
uint32_t native_device(struct native *n, uint32_t kind, uint32_t number, uint32_t base, uint32_t alarm, bool advanced);
/* It answers in the engine's `window`. */
void native_place(struct native *n, uint32_t device, uint32_t window);
void native_rule(struct native *n, uint32_t device, uint32_t word, const struct rule *rule);
void native_irq(struct native *n, uint32_t device, uint32_t place, uint32_t number);
/* As after a reset of the chip or by the peripheral's bit in RCC. */
void native_reset(struct native *n, uint32_t device);
uint32_t *native_words(struct native *n, uint32_t device);
uint64_t native_touched(const struct native *n, uint32_t device, uint32_t word, bool writes);
bool native_is_clocked(const struct native *n, uint32_t device);
void native_clock(struct native *n, uint32_t device, bool on);
/* The clock tree has changed: APB1, APB2, timers on APB1, timers on APB2 [Hz]. */
void native_clocks(struct native *n, uint64_t apb1, uint64_t apb2, uint64_t timer1, uint64_t timer2);

/* The board puts a level on a pin. */
void native_drive(struct native *n, uint32_t port, uint32_t pin, bool level);
/* From now on `pin` gets changes of its level. */
void native_watch(struct native *n, uint32_t port, uint32_t pin);

/* DMA, for drivers in Python. `source` moves between its wakes as well: */
void native_lazy(struct native *n, uint32_t source);
/* At `cycle` it will have something to move; quiet: only a read of registers could show it. */
void native_wake(struct native *n, uint32_t source, uint32_t alarm, uint64_t cycle, bool quiet);
/* One of the sources that drive a stream about to be enabled: the answer to QUERY_ENABLE. */
void native_set_source(struct native *n, uint32_t controller, uint32_t stream, uint32_t place, int32_t source);
/* All streams of a controller have moved what they have until now. */
void native_sync(struct native *n, uint32_t controller);
uint32_t native_total(struct native *n, uint32_t source);      /* items of the transfer; 0: no stream is enabled */
uint32_t native_available(struct native *n, uint32_t source);  /* items until the stream ends or begins anew */
uint32_t native_until_flag(struct native *n, uint32_t source); /* items until it is half through or at its end */
uint32_t native_target(struct native *n, uint32_t source);     /* peripheral address */
bool native_circular(struct native *n, uint32_t source);
bool native_to_memory(struct native *n, uint32_t source);
/* Whether a stream for it is enabled that interrupts. */
bool native_rings(const struct native *n, uint32_t source);
/* Moves items from or to memory; returns how many there were. */
uint32_t native_take(struct native *n, uint32_t source, uint32_t *items, uint32_t count);
uint32_t native_give(struct native *n, uint32_t source, uint32_t *items, uint32_t count);

/* A chip of enum chip_kind, or an empty place for one, behind SPI `spi` (from 0), selected by a pin. Returns its number. */
uint32_t native_chip(struct native *n, uint32_t kind, uint32_t spi, uint32_t port, uint32_t pin);
/* The pin that the SPI's chips answer on. */
void native_miso(struct native *n, uint32_t spi, uint32_t port, uint32_t pin);

/* The SD card in the place CHIP_LOG; none is fitted until Python asks for it here. */
struct card *native_card(struct native *n);
/* Whether the card is selected, and the number of its transaction. */
bool native_card_selected(const struct native *n);
uint32_t native_card_transaction(const struct native *n);
/* Bytes to and from the card that have passed until now are handed over. */
void native_card_sync(struct native *n);

/* The next cycle at which an update of timer `t` asks for its interrupt; NEVER: none does. */
uint64_t native_timer_rings(struct native *n, uint32_t t);

/* Bytes received from the gyro chip have bit errors. */
void native_bit_errors(struct native *n, bool any);

/* The chip's alarms, the length of its data-ready pulse [cycles], and the fastest clock for its data. */
struct gyro *native_gyro(struct native *n, uint32_t alarm, uint32_t fall_alarm, uint64_t pulse, double data_hz);
/* Its data-ready line's pin. */
void native_gyro_ready(struct native *n, uint32_t port, uint32_t pin);
/* Whether `sample` is called from now on. */
void native_hear_samples(struct native *n, bool on);

/* The ESC of motor `motor` (from 0, in order) listens on a pin. */
struct esc *native_esc(struct native *n, uint32_t motor, uint32_t port, uint32_t pin);
/* Channel 1 to 4 of timer `t` may drive its pin. */
/* It takes a frame that Python has decoded, and answers. */
void native_esc_accept(struct native *n, uint32_t motor, uint64_t end, uint32_t data);
/* What the ESCs of the first motors obey: their last values, 0 before any and after `silent` cycles without one. Returns
 * whether that is something else than `values` were before. */
bool native_obeyed(const struct native *n, uint32_t count, uint64_t silent, uint16_t *values);
/* From now on `frames` gets every frame. */
void native_hear_frames(struct native *n);
/* Calls `frames` with those that have come. */
void native_tell_frames(struct native *n);

struct watchdog *native_watchdog(struct native *n, uint32_t alarm);
/* Where its key register lies. */
void native_place_watchdog(struct native *n, uint32_t window, uint32_t offset);

#endif
