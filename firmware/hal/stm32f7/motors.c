#include "motors.h"

#include "clock.h"
#include "dma.h"
#include "dshot.h"
#include "registers.h"
#include "targets/MATEKF722/board.h"

/* DShot600: a bit is 1/600 ms; a 0 is high for 37.5 % of it, a 1 for 75 %. */
#define BIT_TICKS (CLOCK_TIM8_HZ / 600000u)
#define ZERO_TICKS (BIT_TICKS * 3u / 8u)
#define ONE_TICKS (BIT_TICKS * 3u / 4u)
_Static_assert(BIT_TICKS == 360u && ZERO_TICKS == 135u && ONE_TICKS == 270u, "DShot600 at 216 MHz");

#define FRAME_BITS 16u
/* What DMA writes takes effect one bit later (preload), so the first trailing slot ends the last bit with a
 * low line; the second keeps it low for a whole bit before the stream can be seen as free. */
#define SLOTS (FRAME_BITS + 2u)
#define AF_TIM8 3u

enum { PWM_MODE_1 = 6 };               /* TIM_CCMR OCxM: high while the counter is below the compare value */
enum { CCR1_INDEX = 13, BURST_OF_4 = 3 }; /* TIM_DCR: CCR1 is the 13th word, 4 transfers a burst */
_Static_assert(BOARD_MOTOR_COUNT == BURST_OF_4 + 1, "one burst feeds all motors");

/* Compare values of each bit, motors side by side as the burst wants them. The trailing slots stay 0. */
static DMA_BUFFER uint32_t motor_slots[SLOTS][BOARD_MOTOR_COUNT];

void motors_start(void)
{
	for (uint32_t i = 0; i < BOARD_MOTOR_COUNT; ++i)
		gpio_alternate(BOARD_MOTOR(i), AF_TIM8, GPIO_PULL_DOWN, GPIO_MEDIUM);

	TIM_PSC(TIM8) = 0;
	TIM_ARR(TIM8) = BIT_TICKS - 1u;
	for (uint32_t channel = 1; channel <= BOARD_MOTOR_COUNT; ++channel)
		TIM_CCR(TIM8, channel) = 0;
	TIM_CCMR1(TIM8) = FIELD(TIM_CCMR1_OC1M, PWM_MODE_1) | TIM_CCMR1_OC1PE | FIELD(TIM_CCMR1_OC2M, PWM_MODE_1) |
			  TIM_CCMR1_OC2PE;
	TIM_CCMR2(TIM8) = FIELD(TIM_CCMR2_OC3M, PWM_MODE_1) | TIM_CCMR2_OC3PE | FIELD(TIM_CCMR2_OC4M, PWM_MODE_1) |
			  TIM_CCMR2_OC4PE;
	TIM_DCR(TIM8) = FIELD(TIM_DCR_DBL, BURST_OF_4) | FIELD(TIM_DCR_DBA, CCR1_INDEX);
	TIM_EGR(TIM8) = TIM_EGR_UG; /* the preloaded values take effect */
	TIM_CCER(TIM8) = TIM_CCER_CC1E | TIM_CCER_CC2E | TIM_CCER_CC3E | TIM_CCER_CC4E;
	TIM_BDTR(TIM8) |= TIM_BDTR_MOE;
	TIM_CR1(TIM8) = TIM_CR1_ARPE | TIM_CR1_CEN;
	dma_setup(DMA_MOTORS, &TIM_DMAR(TIM8), DMA_TO_PERIPHERAL, DMA_WORD, DMA_VERY_HIGH, 0);
}

bool motors_busy(void)
{
	return dma_busy(DMA_MOTORS);
}

void motors_write(const uint16_t dshot[], size_t count)
{
	if (motors_busy())
		return;
	for (uint32_t motor = 0; motor < BOARD_MOTOR_COUNT && motor < count; ++motor) {
		const uint32_t frame = dshot_frame(dshot[motor], false);

		for (uint32_t bit = 0; bit < FRAME_BITS; ++bit)
			motor_slots[bit][motor] = (frame >> (FRAME_BITS - 1u - bit) & 1u) != 0u ? ONE_TICKS : ZERO_TICKS;
	}
	/* No request may straddle an update, or two motors would get a bit later than the others: requests are
	 * off while the stream starts, and the counter begins a bit (the lines are low, so nothing shows). */
	TIM_DIER(TIM8) &= ~TIM_DIER_UDE;
	TIM_CNT(TIM8) = 0;
	dma_start(DMA_MOTORS, motor_slots, SLOTS * BOARD_MOTOR_COUNT);
	TIM_DIER(TIM8) |= TIM_DIER_UDE;
}

void motors_force_low(void)
{
	RCC_AHB1ENR |= RCC_AHB1ENR_GPIOCEN;
	(void)RCC_AHB1ENR; /* a peripheral answers two cycles after its clock bit (RM0431 5.2.12) */
	for (uint32_t i = 0; i < BOARD_MOTOR_COUNT; ++i)
		gpio_output(BOARD_MOTOR(i), false);
}
