#include "hal/stm32f7/devices/devices.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/fault.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/handlers.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"
#include "hal/stm32f7/core/watchdog.h"
#include "hal/stm32f7/devices/gyro_kinds.h"
#include "hal/stm32f7/peripherals/dma.h"
#include "hal/stm32f7/peripherals/spi.h"
#include "nf_contract.h"

#define AXES 3u

static DMA_BUFFER_SLOW uint8_t gyro_request[GYRO_TRANSFER_BYTES];
static DMA_BUFFER uint8_t gyro_response[GYRO_TRANSFER_BYTES];

/* A sample whose handler takes longer than its period is followed by the next one at once, and nothing below runs in
 * between: no background, and nobody feeds the watchdog. What runs below is owed a cycle for each 8 that samples take,
 * and while it is owed more than a millisecond samples are left out, which counts as lost ones. A single slow sample
 * costs none. */
#define CYCLES_A_CYCLE 8u
#define OWED_MAX (CLOCK_CORE_HZ / 1000u)

/* Between gyro_run, the edge handler, the sample handler and the tick. */
static struct {
	bool found;              /* set up by gyro_start */
	enum gyro_chip chip;     /* that was found */
	struct gyro_layout layout; /* of its samples */
	uint32_t port,
		deselect; /* of its select line: GPIO_BSRR's word that ends a transfer; the upper half begins one */
	uint8_t ready;           /* its data-ready pin, coded */
	bool timed;              /* reads begin at TIM5's beat instead of its edges */
	uint32_t flags, clear;   /* the register of the interrupt's flag, and what to write there to clear it */
	struct dma_stream rx;    /* reads */
	const struct hal_handlers *handlers; /* NULL before gyro_run */
	uint32_t divider;        /* edges or beats a sample */
	uint32_t
		stale; /* timed reads in a row that found nothing new, at most STALE_READS; the sample handler's alone */
	uint32_t until_read; /* edges until the next read; the edge handler's alone */
	volatile uint32_t due; /* reads since gyro_run, made or not; the edge handler's alone */
	volatile uint32_t read; /* `due` of the read that is under way; likewise */
	uint32_t taken; /* `due` of the last sample; sample handler and tick */
	uint32_t ended; /* the last sample [cycle]; the sample handler's alone */
	uint32_t owed; /* to what runs below [cycles]; likewise */
	uint32_t silent_ms; /* since the last sample; sample handler and tick, which share a priority */
	volatile uint32_t samples; /* taken; written by the sample handler alone */
	volatile bool reading; /* a transfer was started and not yet taken */
} gyro;

static inline void gyro_select(void)
{
	GPIO_BSRR(gyro.port) = gyro.deselect << 16;
}

static inline void gyro_deselect(void)
{
	GPIO_BSRR(gyro.port) = gyro.deselect;
}

static bool gyro_transfer(uint8_t *bytes, size_t count)
{
	gyro_select();
	const bool moved = spi_exchange(bytes, count);
	gyro_deselect();
	return moved;
}

/* Runs once: small rather than quick, unlike the transfers. */
__attribute__((cold)) bool gyro_start(const struct board_chip *place, struct gyro_found *found)
{
	const struct pin select = pin_of(place->select);

	if (select.port == 0u || !spi_open(place->spi))
		return false;
	gyro.ready = place->ready;
	gyro.port = select.port;
	gyro.deselect = 1u << select.number;
	gpio_output(select, true);
	gpio_input(pin_of(place->ready), GPIO_PULL_DOWN);
	spi_configure(SPI_844K);

	time_delay_ms(GYRO_START_MS); /* the chip's supply may have come with the processor's */
	watchdog_feed(); /* its half second may be a third, and resets follow */
	if (!gyro_identify(gyro_transfer, &found->identity, &found->kind) || !gyro_set_up(gyro_transfer, found->kind))
		return false;
	gyro.chip = found->kind;
	gyro.layout = *gyro_layout(gyro.chip, pin_of(place->ready).port == 0u);
	gyro.timed = gyro.layout.fresh != 0u;
	gyro.found = true;
	return true;
}

/* The lines of EXTI have their pins' numbers; a port is chosen for each. */
static __attribute__((cold)) void gyro_watch_line(uint8_t code)
{
	static const uint8_t first[] = { IRQ_EXTI0, IRQ_EXTI1, IRQ_EXTI2, IRQ_EXTI3, IRQ_EXTI4 };
	const uint32_t line = code & 0xFu, field = BITS(line % 4u * 4u, 4);

	gyro.flags = (uint32_t)&EXTI_PR;
	gyro.clear = BIT(line);
	SYSCFG_EXTICR(line / 4u + 1u) = (SYSCFG_EXTICR(line / 4u + 1u) & ~field) | FIELD(field, code >> 4);
	EXTI_RTSR |= gyro.clear;
	EXTI_PR = gyro.clear;
	EXTI_IMR |= gyro.clear;
	interrupt_enable(line < sizeof first ? first[line] :
			 line < 10u          ? IRQ_EXTI9_5 :
					       IRQ_EXTI15_10,
			 PRIORITY_GYRO_EDGE);
}

/* TIM5 as it is after a reset but for its period; nobody else uses it (RM0431, general-purpose timers: the counter's update
 * sets SR UIF, which 0 clears). */
static __attribute__((cold)) void gyro_beat(unsigned rate_hz)
{
	RCC_APB1ENR |= RCC_APB1ENR_TIM5EN;
	(void)RCC_APB1ENR; /* a peripheral answers two cycles after its clock bit (RM0431 5.2.12) */
	gyro.flags = (uint32_t)&TIM_SR(TIM5);
	gyro.clear = 0;
	TIM_ARR(TIM5) = CLOCK_TIM5_HZ / rate_hz - 1u;
	TIM_DIER(TIM5) = TIM_DIER_UIE;
	interrupt_enable(IRQ_TIM5, PRIORITY_GYRO_EDGE);
	TIM_CR1(TIM5) = TIM_CR1_CEN;
}

void gyro_run(const struct hal_handlers *handlers, unsigned rate_hz)
{
	HAL_ASSERT(NF_GYRO_EDGE_RATE_HZ % rate_hz == 0u); /* a 0 traps by itself */
	gyro.divider = gyro.timed ? 1u : NF_GYRO_EDGE_RATE_HZ / rate_hz;
	gyro.until_read = 1;
	gyro.reading = false;
	gyro.ended = time_cycles();
	gyro_request[0] = gyro.layout.request;
	barrier();
	gyro.handlers = handlers; /* from here on the tick watches */
	if (!gyro.found)
		return;

	spi_configure(gyro_speed(gyro.chip));
	gyro.rx = spi_dma_setup();
	interrupt_enable(gyro.rx.interrupt, PRIORITY_SAMPLE);
	if (gyro.timed)
		gyro_beat(rate_hz);
	else
		gyro_watch_line(gyro.ready);
}

uint32_t gyro_samples(void)
{
	return gyro.samples;
}

void gyro_tick(void)
{
	if (gyro.handlers == NULL || ++gyro.silent_ms < NF_GYRO_BAD_MS)
		return;
	gyro.silent_ms = 0;
	gyro.taken = gyro.due; /* the silence counts for the reads that failed in it */
	gyro.handlers->gyro_silent(gyro.handlers->context);
}

static void gyro_end_transfer(void)
{
	(void)spi_finish(); /* a stream that is still stuck makes the next spi_start refuse, and samples stop */
	gyro_deselect();
	gyro.reading = false;
}

static void gyro_start_transfer(void)
{
	gyro.reading = true;
	gyro.read = gyro.due;
	gyro_select();
	if (!spi_start(gyro_request, gyro_response, gyro.layout.bytes))
		gyro_end_transfer();
}

/* Samples come only from the chip. If edges or transfers stop, the tick reports silence; if the tick stops too, motor
 * frames end, and the ESCs stop their motors. */
void gyro_edge_handler(void)
{
	REGISTER(gyro.flags) = gyro.clear;
	barrier(); /* cleared before the handler can return, or it would run twice */
	if (--gyro.until_read != 0u)
		return;
	gyro.until_read = gyro.divider;
	++gyro.due;
	if (gyro.reading && (dma_complete(gyro.rx) || gyro.due - gyro.read < 2u))
		return; /* read but not yet taken, as the control path is late, or begun late: this sample is lost */
	if (gyro.reading)
		gyro_end_transfer(); /* a read takes 9 to 41 us: this one is stuck */
	gyro_start_transfer();
}

/* 70 mdeg/s in counts of 2000 / 32768 deg/s: times 3584 / 3125, to the nearest. What lies beyond +-2000 deg/s saturates.
 * From flash: few chips need it. */
static __attribute__((noinline)) void gyro_refine(int16_t words[AXES])
{
	for (uint32_t axis = 0; axis < AXES; ++axis) {
		const int32_t counts = (words[axis] * 3584 + (words[axis] < 0 ? -1562 : 1562)) / 3125;
		words[axis] = (int16_t)(counts < INT16_MIN ? INT16_MIN : counts > INT16_MAX ? INT16_MAX : counts);
	}
}

/* Reads `count` words from byte `at` of the response on. */
static __attribute__((noinline)) void gyro_words(uint32_t at, uint32_t upper, uint32_t count, int16_t *words)
{
	for (const volatile uint8_t *bytes = gyro_response + at; count-- != 0u; bytes += 2)
		*words++ = (int16_t)(uint16_t)(bytes[upper] << 8 | bytes[upper ^ 1u]);
}

/* Of a timed read: has the chip measured lately? Its clock is its own: of 8,000 reads a second up to 2 % find nothing new
 * because it is slow, and the sample before stands for one more period. One that has died, or whose line has come off,
 * says nothing new ever again, or 0xFF. From flash, like gyro_refine. */
#define STALE_READS 4u
static __attribute__((noinline)) bool gyro_measures(uint32_t told, uint32_t fresh)
{
	if ((told & fresh) != 0u && told != 0xFFu)
		gyro.stale = 0;
	else if (gyro.stale < STALE_READS)
		++gyro.stale;
	return gyro.stale < STALE_READS;
}

/* Has what runs below had its share up to now? */
static bool gyro_share(uint32_t now)
{
	const uint32_t had = now - gyro.ended;

	gyro.owed -= had < gyro.owed ? had : gyro.owed;
	gyro.ended = now;
	return gyro.owed <= OWED_MAX;
}

void gyro_sample_handler(void)
{
	const struct gyro_layout layout = gyro.layout;
	struct imu_sample sample;
	const uint32_t begun = time_cycles();

	/* The edge handler may not come between: it would take the half-ended transfer for a stuck one. */
	interrupts_disable();
	if (!gyro_share(begun)) {
		gyro_end_transfer();
		interrupts_enable();
		return;
	}
	sample.valid = dma_complete(gyro.rx); /* or it ended in an error of the bus */
	const uint32_t lost = gyro.read - gyro.taken - 1u;

	gyro.taken = gyro.read;
	gyro_end_transfer();
	gyro_words(layout.accel, layout.upper, AXES, sample.accel);
	gyro_words(layout.gyro, layout.upper, AXES, sample.gyro);
	gyro_words(layout.temperature, layout.upper, 1, &sample.temperature);
	const uint32_t told = *(const volatile uint8_t *)&gyro_response[layout.status];

	/* What follows may wait for flash that is being erased: edges and beats may not. */
	interrupts_enable();
	if (layout.coarse)
		gyro_refine(sample.gyro);
	if (layout.fresh != 0u && !gyro_measures(told, layout.fresh))
		sample.valid = false;
	/* A read that was under way in a silence has been counted by it: then this is -1. */
	sample.lost = lost < NF_GYRO_EDGE_RATE_HZ ? (uint16_t)lost : 0u;
	gyro.silent_ms = 0;
	++gyro.samples;
	gyro.handlers->sample(gyro.handlers->context, &sample);
	gyro.ended = time_cycles();
	gyro.owed += (gyro.ended - begun) / CYCLES_A_CYCLE;
}
