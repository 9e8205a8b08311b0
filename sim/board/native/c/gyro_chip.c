/* The gyro chip's samples and the reads of its data in C: sim/board/devices/gyro_chip.py says what the chip does and why, and
 * does whatever is not plain. */
#include <string.h>

#include "native.h"

enum { READY_PORT = 2, READY_PIN = 3 };
enum { DATA = 0x3B, READ = 0x80 };

void gyro_sample(struct hot *h)
{
	struct gyro *const g = &h->s.gyro;
	const uint64_t due = g->due;

	g->due = due + g->period;
	engine_set_alarm(h->e, h->gyro_alarm, g->due);
	++g->samples;
	for (uint32_t i = 0; i < GYRO_VALUES; ++i) { /* the upper byte first */
		g->data[2u * i] = (uint8_t)((uint16_t)g->measured[i] >> 8);
		g->data[2u * i + 1u] = (uint8_t)g->measured[i];
	}
	g->interrupt = 1;
	hot_pulse(h, READY_PORT, READY_PIN);
	if (exti_watches_fall(h, READY_PIN))
		engine_set_alarm(h->e, h->gyro_fall_alarm, due + h->gyro_pulse);
}

bool gyro_exchange(struct hot *h, uint8_t *bytes, uint32_t count, double hz, uint32_t mode)
{
	struct gyro *const g = &h->s.gyro;
	const bool begins = g->transaction != h->s.transaction || g->address == NO_ADDRESS;
	const uint32_t place = (begins ? bytes[0] & ~(uint32_t)READ : g->address) - DATA, rest = count - begins;

	if (!h->gyro_answers || (mode != 0u && mode != 3u) || hz > h->gyro_data_hz || place > GYRO_BYTES ||
	    rest > GYRO_BYTES - place)
		return false;
	if (begins && g->reads && g->address - DATA < GYRO_BYTES && (g->address - DATA) % 2u != 0u)
		return false; /* the transaction before ended inside a value */
	if (begins ? (bytes[0] & READ) == 0u || now(h) < g->ready_at : !g->reads)
		return false;
	if (begins) {
		g->transaction = h->s.transaction;
		g->selected = g->reads = 1;
		memcpy(g->shadow, g->data, sizeof g->shadow);
		*bytes++ = 0;
	}
	memcpy(bytes, g->shadow + place, rest);
	g->address = DATA + place + rest;
	return true;
}

struct gyro *hot_gyro_state(struct hot *h)
{
	return &h->s.gyro;
}

/* The chip's alarms, the length of its data-ready pulse [cycles], and the fastest clock for its data. */
void hot_gyro(struct hot *h, uint32_t alarm, uint32_t fall_alarm, uint64_t pulse, double data_hz)
{
	h->gyro_alarm = alarm;
	h->gyro_fall_alarm = fall_alarm;
	h->gyro_pulse = pulse;
	h->gyro_data_hz = data_hz;
}

/* Whether samples are plain, and answers: if not, they are Python's. */
void hot_gyro_plain(struct hot *h, bool samples, bool answers)
{
	h->gyro_samples = samples;
	h->gyro_answers = answers;
}
