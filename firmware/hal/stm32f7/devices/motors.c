#include "hal/stm32f7/devices/devices.h"

#include "board.h"
#include "hal/stm32f7/core/clock.h"
#include "hal/stm32f7/core/fault.h"
#include "hal/stm32f7/core/motor_pins.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/peripherals/dma.h"
#include "motors/dshot.h"
#include "nf_contract.h"

#define FRAME_BITS 16u
/* What DMA writes takes effect one bit later (preload), so the first trailing slot ends the last bit with a
 * low line; the second keeps it low for a whole bit before the stream can be seen as free. */
#define SLOTS (FRAME_BITS + 2u)

enum { PWM_MODE_1 = 6 };                  /* TIM_CCMR OCxM: high while the counter is below the compare value */
enum { CCR1_INDEX = 13, BURST_OF_4 = 3 }; /* TIM_DCR: CCR1 is the 13th word, 4 transfers a burst */

/* Pulse widths, bit by bit, as DMA moves them: four motors side by side for the burst, then one alone. The
 * trailing slots stay 0. */
#define BURST_WIDTH 4u
static DMA_BUFFER_SLOW uint32_t motor_slots[SLOTS * BOARD_MOTOR_COUNT];

/* A timer and the motors that it drives. */
struct bank {
	uint32_t timer;
	uint32_t clock_hz;
	uint32_t first;              /* motor, by index */
	uint32_t width;              /* motors */
	struct dma_stream stream;
	volatile uint32_t *target;   /* where DMA writes */
	uint32_t request;            /* TIM_DIER: asks for DMA at every bit's begin */
	uint32_t *slots;             /* SLOTS times `width` */
	uint32_t ccmr1, ccmr2, ccer; /* compare channels in use */
	bool advanced;               /* has a main output switch */
};

/* Compare channels in use. */
// clang-format off
#define CHANNEL_1 .ccmr1 = FIELD(TIM_CCMR1_OC1M, PWM_MODE_1) | TIM_CCMR1_OC1PE, .ccer = TIM_CCER_CC1E
#define CHANNEL_4 .ccmr2 = FIELD(TIM_CCMR2_OC4M, PWM_MODE_1) | TIM_CCMR2_OC4PE, .ccer = TIM_CCER_CC4E
#define CHANNELS_1_TO_4                                                                \
	.ccmr1 = FIELD(TIM_CCMR1_OC1M, PWM_MODE_1) | TIM_CCMR1_OC1PE |                 \
		 FIELD(TIM_CCMR1_OC2M, PWM_MODE_1) | TIM_CCMR1_OC2PE,                  \
	.ccmr2 = FIELD(TIM_CCMR2_OC3M, PWM_MODE_1) | TIM_CCMR2_OC3PE |                 \
		 FIELD(TIM_CCMR2_OC4M, PWM_MODE_1) | TIM_CCMR2_OC4PE,                  \
	.ccer = TIM_CCER_CC1E | TIM_CCER_CC2E | TIM_CCER_CC3E | TIM_CCER_CC4E

/* The rows of board.h: four motors on all channels of a timer, or one on one of them. `dma`, `dma_request`: what
 * moves the pulse widths at each bit's begin. */
#define MOTOR_BANK_OF_4(motor, tim, hz, dma, dma_request, switched)                                \
	{                                                                                          \
		.timer = tim, .clock_hz = hz, .first = motor, .width = BURST_WIDTH, .stream = dma, \
		.target = &TIM_DMAR(tim), .request = dma_request,                                  \
		.slots = motor_slots + SLOTS * motor, CHANNELS_1_TO_4, .advanced = switched        \
	}
#define MOTOR_BANK_OF_1(motor, tim, channel, hz, dma, dma_request, switched)             \
	{                                                                                \
		.timer = tim, .clock_hz = hz, .first = motor, .width = 1, .stream = dma, \
		.target = &TIM_CCR(tim, channel), .request = dma_request,                \
		.slots = motor_slots + SLOTS * motor, CHANNEL_##channel, .advanced = switched \
	}
// clang-format on
static const struct bank banks[] = { BOARD_MOTOR_BANKS };
#define BANK_COUNT (sizeof banks / sizeof banks[0])

static const uint32_t bits_a_second[] = {
	[NF_MOTOR_PROTOCOL_DSHOT300] = 300000,
	[NF_MOTOR_PROTOCOL_DSHOT600] = 600000,
	[NF_MOTOR_PROTOCOL_DSHOT150] = 150000,
};

struct pulse {
	uint32_t zero; /* ticks that a bit is high: 37.5 % of it */
	uint32_t more; /* for a one, 75 % */
};

/* Set by motors_run. */
static uint32_t banks_in_use, bits_hz;
static struct pulse pulses[BANK_COUNT];

/* A frame has long ended by the next write, a gyro period later: 107 us with DShot150, 125 us at 8 kHz. A stream that is
 * enabled at so many writes in a row gets no requests any more, and would never end by itself. */
#define STUCK_WRITES 4u
static uint32_t writes_dropped, restarts;

static __attribute__((cold, noinline)) void motors_start_bank(const struct bank *bank, uint32_t bit_ticks)
{
	TIM_PSC(bank->timer) = 0;
	TIM_ARR(bank->timer) = bit_ticks - 1u;
	for (uint32_t channel = 1; channel <= 4u; ++channel)
		TIM_CCR(bank->timer, channel) = 0;
	if (bank->ccmr1 != 0u)
		TIM_CCMR1(bank->timer) = bank->ccmr1;
	if (bank->ccmr2 != 0u)
		TIM_CCMR2(bank->timer) = bank->ccmr2;
	if (bank->width == BURST_WIDTH)
		TIM_DCR(bank->timer) = FIELD(TIM_DCR_DBL, BURST_OF_4) | FIELD(TIM_DCR_DBA, CCR1_INDEX);
	if (bank->request != TIM_DIER_UDE)
		TIM_CR2(bank->timer) = TIM_CR2_CCDS;
	TIM_EGR(bank->timer) = TIM_EGR_UG; /* the preloaded values take effect */
	TIM_CCER(bank->timer) = bank->ccer;
	if (bank->advanced)
		TIM_BDTR(bank->timer) |= TIM_BDTR_MOE;
	TIM_CR1(bank->timer) = TIM_CR1_ARPE | TIM_CR1_CEN;
	dma_setup(bank->stream, bank->target, DMA_TO_PERIPHERAL, DMA_WORD, DMA_VERY_HIGH, 0);
}

/* Runs once: small rather than quick, unlike the frames. */
__attribute__((cold)) void motors_run(uint32_t protocol, size_t count)
{
	HAL_ASSERT(protocol < sizeof bits_a_second / sizeof bits_a_second[0] && count <= BOARD_MOTOR_COUNT);
	uint32_t used = 0;

	for (; used < BANK_COUNT && banks[used].first < count; ++used) {
		bits_hz = bits_a_second[protocol];
		const uint32_t ticks = banks[used].clock_hz / bits_hz;

		pulses[used].zero = ticks * 3u / 8u;
		pulses[used].more = ticks * 3u / 4u - pulses[used].zero;
		motors_start_bank(&banks[used], ticks);
	}
	motor_pins_connect(count);
	barrier();
	banks_in_use = used;
}

/* Does DMA still read a frame? */
static bool motors_busy(void)
{
	for (uint32_t i = 0; i < banks_in_use; ++i)
		if (dma_busy(banks[i].stream))
			return true;
	return false;
}

#define FRAME_CYCLES (CLOCK_CORE_HZ / 5000u) /* 200 us; the longest, DShot150, takes 107 */

__attribute__((cold)) void motors_finish(void)
{
	const uint32_t start = time_cycles();

	while (motors_busy() && time_cycles() - start < FRAME_CYCLES)
		;
}

/* Ends each stream that is stuck and sets its timer up anew, as at the start: the lines are low from here on. No frame is
 * sent yet. What an ESC has of the one that broke off has no 16 bits; it forgets them in the rest before the next write. A
 * stream that cannot be ended is tried again later. */
static __attribute__((cold, noinline)) void motors_restart(void)
{
	++restarts;
	for (uint32_t i = 0; i < banks_in_use; ++i) {
		const struct bank *const bank = &banks[i];

		if (!dma_busy(bank->stream))
			continue;
		TIM_DIER(bank->timer) &= ~bank->request;
		if (dma_stop(bank->stream))
			motors_start_bank(bank, bank->clock_hz / bits_hz);
	}
}

uint32_t motors_restarts(void *context)
{
	return restarts;
}

/* Requests are off while the stream starts, and the counter restarts a bit, so that no update falls in between: else
 * one bank's motors would get a bit later than the others. The lines are low meanwhile. */
static void motors_send(const struct bank *bank)
{
	TIM_DIER(bank->timer) &= ~bank->request;
	TIM_CNT(bank->timer) = 0;
	dma_start(bank->stream, bank->slots, SLOTS * bank->width);
	TIM_DIER(bank->timer) |= bank->request;
}

/* A motor's pulses, every `width` words. Unrolled it is three instructions a bit, for every motor and frame. */
static inline __attribute__((always_inline)) void motors_fill(uint32_t *slots, uint32_t width, uint32_t frame,
							      const struct pulse *pulse)
{
	const uint32_t zero = pulse->zero, more = pulse->more;

#pragma GCC unroll 16
	for (uint32_t bit = 0; bit < FRAME_BITS; ++bit)
		slots[bit * width] = zero + (frame >> (FRAME_BITS - 1u - bit) & 1u) * more;
}

/* The pulses of a motor that is alone in its bank, of which a quad has none: shorter in ITCM, half as many instructions more. */
static void motors_fill_alone(uint32_t *slots, uint32_t frame, const struct pulse *pulse)
{
	const uint32_t zero = pulse->zero, more = pulse->more;

#pragma GCC unroll 4
	for (uint32_t bit = 0; bit < FRAME_BITS; ++bit)
		slots[bit] = zero + (frame >> (FRAME_BITS - 1u - bit) & 1u) * more;
}

void motors_write(void *context, const uint16_t dshot[], size_t count, bool telemetry)
{
	if (motors_busy()) {
		if (++writes_dropped % STUCK_WRITES == 0)
			motors_restart();
		return;
	}
	writes_dropped = 0;
	for (uint32_t i = 0; i < banks_in_use; ++i) {
		const struct bank *const bank = &banks[i];

		for (uint32_t motor = 0; motor < bank->width; ++motor) {
			const uint32_t index = bank->first + motor;
			const uint32_t frame = dshot_frame(index < count ? dshot[index] : NF_DSHOT_STOP, telemetry,
							   false);

			if (bank->width == BURST_WIDTH)
				motors_fill(bank->slots + motor, BURST_WIDTH, frame, &pulses[i]);
			else
				motors_fill_alone(bank->slots, frame, &pulses[i]);
		}
		motors_send(bank);
	}
}
