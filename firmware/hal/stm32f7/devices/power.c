#include "hal/stm32f7/devices/devices.h"

#include "hal/stm32f7/core/board.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/peripherals/dma.h"

enum { DIVIDE_BY_4 = 1 };                       /* ADC_CCR ADCPRE: 27 MHz, 36 at most */
enum { CYCLES_480 = 7 };                        /* ADC1_SMPR: the divider's 10 kOhm charge the sampler */
enum { CHANNELS = 2, CHANNEL_NONE = 0xFF };

/* A conversion takes 492 cycles, 18.2 us. */
#define ROUNDS 32u
#define FULL_SCALE 4095u
/* The board's regulator is the reference. Its error of a few per cent and the divider's are corrected by the setting
 * battery_scale; the chip's own reference voltage would not correct the divider's. */
#define REFERENCE_MV 3300u

/* Round by round the conversions of the channels in use. */
static DMA_BUFFER_SLOW volatile uint16_t power_conversions[ROUNDS * CHANNELS];

/* Set by power_start. */
static uint32_t power_channels;              /* in use: voltage first, then current */
static bool power_measures_volts;
static struct dma_stream power_dma;

/* The channel of ADC1 behind a pin (data sheet, pin definitions). */
static uint32_t power_channel(uint8_t code)
{
	const uint32_t number = code & 0xFu;

	switch (code >> 4) {
	case 0: /* PA0 to PA7 */
		return number < 8u ? number : CHANNEL_NONE;
	case 1: /* PB0, PB1 */
		return number < 2u ? 8u + number : CHANNEL_NONE;
	case 2: /* PC0 to PC5 */
		return number < 6u ? 10u + number : CHANNEL_NONE;
	default:
		return CHANNEL_NONE;
	}
}

/* Takes the pin into the sequence. False: it leads to no channel. */
static bool power_add(uint8_t code)
{
	const uint32_t channel = power_channel(code);

	if (channel == CHANNEL_NONE)
		return false;
	gpio_mode(pin_of(code), GPIO_ANALOG);
	if (channel < 10u)
		ADC1_SMPR2 |= CYCLES_480 << 3u * channel;
	else
		ADC1_SMPR1 |= CYCLES_480 << 3u * (channel - 10u);
	ADC1_SQR3 |= channel << 5u * power_channels;
	++power_channels;
	return true;
}
_Static_assert(ADC1_SQR3_SQ1 == BITS(0, 5) && ADC1_SQR3_SQ2 == BITS(5, 5), "channels side by side");

static void power_convert(void)
{
	ADC1_SR &= ~ADC1_SR_OVR;
	dma_start(power_dma, power_conversions, ROUNDS * power_channels);
	ADC1_CR2 = ADC1_CR2_ADON | ADC1_CR2_CONT | ADC1_CR2_DMA | ADC1_CR2_DDS;
	ADC1_CR2 |= ADC1_CR2_SWSTART;
}

void power_start(void)
{
	power_dma = stream_of(board.adc_dma);
	if (power_dma.at == 0u)
		return;
	ADC_CCR = FIELD(ADC_CCR_ADCPRE, DIVIDE_BY_4);
	ADC1_CR1 = ADC1_CR1_SCAN;
	power_measures_volts = power_add(board.volts);
	(void)power_add(board.amps);
	if (power_channels == 0u)
		return;
	ADC1_SQR1 = FIELD(ADC1_SQR1_L, power_channels - 1u);
	dma_setup(power_dma, &ADC1_DR, DMA_FROM_PERIPHERAL, DMA_HALF_WORD, DMA_LOW, DMA_SCR_CIRC);
	ADC1_CR2 = ADC1_CR2_ADON; /* 3 us before the first conversion; the next call comes later than that */
}

/* Of the channel in use with that number; 0 where there is none. */
static uint16_t power_mean_mv(uint32_t channel)
{
	uint32_t sum = 0;

	if (channel >= power_channels)
		return 0;
	for (uint32_t i = channel; i < ROUNDS * power_channels; i += power_channels)
		sum += power_conversions[i];
	return (uint16_t)(sum * REFERENCE_MV / (FULL_SCALE * ROUNDS));
}
_Static_assert(UINT32_MAX / REFERENCE_MV >= FULL_SCALE * ROUNDS, "mean_mv's product fits");

void power_read(void *context, struct power_sample *power)
{
	*power = (struct power_sample){ .valid = false };
	if (power_channels == 0u)
		return;
	power->valid = dma_complete(power_dma);
	power->volts_mv = power_measures_volts ? power_mean_mv(0) : 0u;
	power->amps_mv = power_mean_mv(power_measures_volts ? 1u : 0u);
	dma_clear(power_dma);
	/* Not begun yet, or stopped by an overrun or an error of the bus. */
	if (!dma_busy(power_dma) || (ADC1_SR & ADC1_SR_OVR) != 0u) {
		(void)dma_stop(power_dma);
		ADC1_CR2 = ADC1_CR2_ADON;
		power_convert();
	}
}
