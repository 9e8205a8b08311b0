/* What the peripherals call of each other. What Python calls of them is in api.h. */
#ifndef NATIVE_PERIPHERALS_H
#define NATIVE_PERIPHERALS_H

#include "native.h"

/* ---- pins.c: GPIO and EXTI ---- */

enum { MODER = 0, OTYPER = 1, PUPDR = 3, IDR = 4, ODR = 5, BSRR = 6 }; /* words of GPIO */

void exti_update(struct native *n);
bool exti_watches_fall(const struct native *n, uint32_t line);
void exti_write(struct native *n, uint32_t word, uint32_t value);
void pins_tell(struct native *n, uint32_t port); /* its watched pins' levels, where they have changed */
void pins_pulse(struct native *n, uint32_t port, uint32_t pin);
uint32_t pins_read(struct native *n, uint32_t device, uint32_t word);
void pins_write(struct native *n, uint32_t device, uint32_t word, uint32_t value);
/* DMA writes `count` items to a register of a port, `shift` bits up in it, the first at cycle `start`, one each `step`. */
void pins_put(struct native *n, uint32_t port, uint32_t word, uint32_t shift, const uint32_t *items, uint32_t count,
	      uint64_t start, uint64_t step);
/* DMA reads as many. */
void pins_sample(struct native *n, uint32_t port, uint32_t word, uint32_t shift, uint32_t *items, uint32_t count,
		 uint64_t start, uint64_t step);

/* ---- dma.c: DMA1 and DMA2 ---- */

void dma_reset(struct native *n, uint32_t controller);
void dma_sleep(struct native *n); /* the core sleeps: fails if a stream reads DTCM, which does not answer then */
uint32_t dma_read(struct native *n, uint32_t device, uint32_t word);
void dma_write(struct native *n, uint32_t device, uint32_t word, uint32_t value);

/* ---- spi.c: SPI1 to SPI3 as masters; `i`: from 0 ---- */

enum { SPI_DR = 3 }; /* word */

extern const struct driver spi_driver;

void spi_reset(struct native *n, uint32_t i);
void spi_sync(struct native *n, uint32_t i);
void spi_start(struct native *n, uint32_t i);
void spi_plan(struct native *n, uint32_t i);
uint32_t spi_read(struct native *n, uint32_t i, uint32_t word, uint32_t size);
void spi_write(struct native *n, uint32_t i, uint32_t word, uint32_t size, uint32_t value);

/* ---- timer.c ---- */

extern const struct driver timer_driver;

void timer_reset(struct native *n, uint32_t t);
void timer_clocks(struct native *n, uint64_t apb1, uint64_t apb2); /* of timers on these buses, from now on [Hz] */
void timer_sync(struct native *n, uint32_t t);
void timers_sync_ports(struct native *n); /* what DMA moves to and from ports has moved until now */
void timer_plan(struct native *n, uint32_t t); /* the alarm for the next update that an interrupt or a stream waits for */
uint32_t timer_read(struct native *n, uint32_t device, uint32_t word);
void timer_write(struct native *n, uint32_t device, uint32_t word, uint32_t value);

/* ---- what hangs on them: gyro_chip.c and card.c behind SPIs, esc.c on the motors' lines, watchdog.c ---- */

void gyro_sample(struct native *n);
void gyro_fall(struct native *n); /* of the data-ready line */
/* Bytes of a transaction, answered in place; false: Python is to answer. */
bool gyro_exchange(struct native *n, uint8_t *bytes, uint32_t count, double hz, uint32_t mode);

/* Bytes that begin at `cycle` and last `length` cycles each, answered in place; false: Python is to answer. */
bool card_exchange(struct native *n, uint8_t *bytes, uint32_t count, uint64_t cycle, uint32_t length);

/* The line has another level from `cycle` on, but for what the ESC drives. Python gets the edges of what is no plain frame. */
void esc_edge(struct native *n, struct esc *esc, uint64_t cycle, bool level);
/* The program drives the pin from now on, or does not. */
void esc_output(struct native *n, struct esc *esc, bool output);
/* Whether the ESC drives the line at `cycle`, and to which level. */
bool esc_drives(const struct esc *esc, uint64_t cycle, bool *level);
/* What DMA samples of the line, `resting` where nobody drives it: adds `bit` to each item where it is high. */
void esc_sample(struct esc *esc, uint32_t bit, bool resting, uint32_t *items, uint32_t count, uint64_t start, uint64_t step);

/* Takes a write that feeds the watchdog while it runs; false: it is another write. */
bool watchdog_feed(struct native *n, uint32_t window, uint32_t offset, uint32_t size, uint32_t value);

#endif
