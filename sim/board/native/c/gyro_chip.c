/* The gyro chip's samples, and reads of its data, and of what lies around them, in one transaction. Its other registers are Python's
 * (sim/board/devices/gyro_chip.py). */
#include <string.h>

#include "peripherals.h"

enum { READ = 0x80 };

/* What is measured at +-2000 deg/s and +-16 g, as the full scale that is set shows it; i: accelerometer, temperature, gyro. */
static int16_t gyro_value(const struct gyro *g, uint32_t i)
{
	const int shift = i < 3u ? g->accel_shift : i > 3u ? g->gyro_shift : 0;
	const int32_t value = shift >= 0 ? g->measured[i] * (1 << shift) : g->measured[i] >> -shift;

	return (int16_t)(value < INT16_MIN ? INT16_MIN : value > INT16_MAX ? INT16_MAX : value);
}

void gyro_sample(struct native *n)
{
	struct gyro *const g = &n->s.gyro;
	const uint64_t due = g->due; /* the core may be in the middle of an instruction now */

	g->due = due + g->period;
	engine_set_alarm(n->e, n->gyro_alarm, g->due);
	if (n->samples_heard)
		n->callbacks.sample(g->samples);
	++g->samples;
	if (g->silent)
		return;
	for (uint32_t i = 0; i < GYRO_VALUES; ++i) {
		const uint16_t value = (uint16_t)gyro_value(g, g->order[i]);

		g->data[2u * i + g->little] = (uint8_t)(value >> 8);
		g->data[2u * i + !g->little] = (uint8_t)value;
	}
	g->interrupt = 1;
	if (n->ready.port == NO_PORT)
		return;
	pins_pulse(n, n->ready.port, n->ready.pin);
	if (exti_watches_fall(n, n->ready.pin))
		engine_set_alarm(n->e, n->gyro_fall_alarm, due + n->gyro_pulse);
}

void gyro_fall(struct native *n)
{
	native_drive(n, n->ready.port, n->ready.pin, false);
}

static uint8_t gyro_told(struct gyro *g, uint32_t place)
{
	const uint32_t entry = g->window[place];

	if (entry != GYRO_STATUS)
		return entry < GYRO_BYTES ? g->shadow[entry] : (uint8_t)entry;
	const uint8_t status = g->interrupt ? g->ready_bit : 0;

	g->interrupt = 0;
	return status;
}

bool gyro_exchange(struct native *n, uint8_t *bytes, uint32_t count, double hz, uint32_t mode)
{
	struct gyro *const g = &n->s.gyro;
	const uint32_t transaction = n->s.chips[n->gyro_chip].transaction;
	const bool begins = g->transaction != transaction || g->address == NO_ADDRESS;
	const uint32_t rest = count - begins, dummies = begins ? g->dummies : g->dummies_left;
	const uint32_t silent = dummies < rest ? dummies : rest, told = rest - silent;
	uint32_t place = (begins ? bytes[0] & ~(uint32_t)READ : g->address) - g->window_at;

	if (g->hidden || (mode != 0u && mode != 3u) || hz > n->gyro_data_hz || place > g->window_count ||
	    told > g->window_count - place)
		return false;
	if (begins && g->reads && g->address != g->first && g->address - g->data_at < GYRO_BYTES &&
	    (g->address - g->data_at) % 2u != 0u)
		return false; /* the transaction before ended inside a value */
	if (begins ? (bytes[0] & READ) == 0u || native_now(n) < g->ready_at : !g->reads)
		return false;
	if (begins) {
		g->transaction = transaction;
		g->reads = 1;
		g->first = g->window_at + place;
		memcpy(g->shadow, g->data, sizeof g->shadow);
		*bytes++ = 0;
	}
	memset(bytes, 0, silent);
	for (uint32_t i = silent; i < rest; ++i)
		bytes[i] = gyro_told(g, place++);
	g->dummies_left = (uint8_t)(dummies - silent);
	g->address = g->window_at + place;
	return true;
}

struct gyro *native_gyro(struct native *n, uint32_t alarm, uint32_t fall_alarm, uint64_t pulse, double data_hz)
{
	n->gyro_alarm = alarm;
	n->gyro_fall_alarm = fall_alarm;
	n->gyro_pulse = pulse;
	n->gyro_data_hz = data_hz;
	n->s.gyro.due = NEVER;
	n->s.gyro.address = NO_ADDRESS;
	return &n->s.gyro;
}

void native_gyro_ready(struct native *n, uint32_t port, uint32_t pin)
{
	n->ready = (struct pin){(uint8_t)port, (uint8_t)pin};
}

void native_hear_samples(struct native *n, bool on)
{
	n->samples_heard = on;
}
