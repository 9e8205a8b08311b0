#include "hal/stm32f7/devices/devices.h"

#include "board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/peripherals/dma.h"

enum { CHANNEL_VOLTS = 10, CHANNEL_AMPS = 14 }; /* of ADC1, behind the pins (data sheet, pin definitions) */
enum { DIVIDE_BY_4 = 1 };                       /* ADC_CCR ADCPRE: 27 MHz, 36 at most */
enum { CYCLES_480 = 7 };                        /* ADC1_SMPR: the divider's 10 kOhm charge the sampler */
enum { CHANNELS = 2 };

/* A conversion takes 492 cycles, 18.2 us. */
#define ROUNDS 32u
#define FULL_SCALE 4095u
/* The board's regulator is the reference. Its error of a few per cent and the divider's are corrected by the setting
 * battery_scale; the chip's own reference voltage would not correct the divider's. */
#define REFERENCE_MV 3300u

static DMA_BUFFER_SLOW volatile uint16_t power_conversions[ROUNDS][CHANNELS];

static void power_convert(void)
{
	ADC1_SR &= ~ADC1_SR_OVR;
	dma_start(DMA_POWER, power_conversions, ROUNDS * CHANNELS);
	ADC1_CR2 = ADC1_CR2_ADON | ADC1_CR2_CONT | ADC1_CR2_DMA | ADC1_CR2_DDS;
	ADC1_CR2 |= ADC1_CR2_SWSTART;
}

void power_start(void)
{
	gpio_mode(BOARD_VOLTS, GPIO_ANALOG);
	gpio_mode(BOARD_AMPS, GPIO_ANALOG);
	ADC_CCR = FIELD(ADC_CCR_ADCPRE, DIVIDE_BY_4);
	ADC1_CR1 = ADC1_CR1_SCAN;
	ADC1_SMPR1 = FIELD(ADC1_SMPR1_SMP10, CYCLES_480) | FIELD(ADC1_SMPR1_SMP14, CYCLES_480);
	ADC1_SQR1 = FIELD(ADC1_SQR1_L, CHANNELS - 1);
	ADC1_SQR3 = FIELD(ADC1_SQR3_SQ1, CHANNEL_VOLTS) | FIELD(ADC1_SQR3_SQ2, CHANNEL_AMPS);
	dma_setup(DMA_POWER, &ADC1_DR, DMA_FROM_PERIPHERAL, DMA_HALF_WORD, DMA_LOW, DMA_SCR_CIRC);
	ADC1_CR2 = ADC1_CR2_ADON; /* 3 us before the first conversion; the next call comes later than that */
}

static uint16_t power_mean_mv(uint32_t channel)
{
	uint32_t sum = 0;

	for (uint32_t i = 0; i < ROUNDS; ++i)
		sum += power_conversions[i][channel];
	return (uint16_t)(sum * REFERENCE_MV / (FULL_SCALE * ROUNDS));
}
_Static_assert(UINT32_MAX / REFERENCE_MV >= FULL_SCALE * ROUNDS, "mean_mv's product fits");

void power_read(void *context, struct power_sample *power)
{
	power->valid = dma_complete(DMA_POWER);
	power->volts_mv = power_mean_mv(0);
	power->amps_mv = power_mean_mv(1);
	dma_clear(DMA_POWER);
	/* Not begun yet, or stopped by an overrun or an error of the bus. */
	if (!dma_busy(DMA_POWER) || (ADC1_SR & ADC1_SR_OVR) != 0u) {
		(void)dma_stop(DMA_POWER);
		ADC1_CR2 = ADC1_CR2_ADON;
		power_convert();
	}
}
