#include "hal/stm32f7/core/clock.h"

#include "hal/stm32f7/core/core.h"
#include "hal/stm32f7/core/gpio.h"
#include "hal/stm32f7/core/registers.h"
#include "hal/stm32f7/core/time.h"

/* VCO input 2 MHz (the manual's choice against jitter), VCO 432 MHz, USB clock 432 / 9 = 48 MHz. */
#define PLL_M (CLOCK_CRYSTAL_HZ / PLL_INPUT_HZ)
#define PLL_M_INTERNAL (CLOCK_RESET_HZ / PLL_INPUT_HZ)
#define PLL_INPUT_HZ 2000000u
#define PLL_N 216u
#define PLL_P 2u
#define PLL_Q 9u
_Static_assert(CLOCK_CRYSTAL_HZ % PLL_INPUT_HZ == 0u && CLOCK_RESET_HZ % PLL_INPUT_HZ == 0u,
	       "either makes the VCO's input");
_Static_assert(PLL_N / PLL_P * PLL_INPUT_HZ == CLOCK_CORE_HZ, "the PLL makes the core clock");
_Static_assert(PLL_N / PLL_Q * PLL_INPUT_HZ == 48000000u, "USB needs 48 MHz");

enum { SOURCE_HSI = 0, SOURCE_PLL = 2 };      /* RCC_CFGR SW and SWS */
enum { DIVIDE_BY_2 = 4, DIVIDE_BY_4 = 5 };    /* RCC_CFGR PPRE1 and PPRE2 */
enum { REGULATOR_SCALE_1 = 3 };               /* PWR_CR1 VOS */
enum { WAIT_STATES = 7 };                     /* 216 MHz at 2.7..3.6 V (RM0431 3.3, table of wait states) */

/* All waits run from HSI or, after the switch, a clock that is already up. */
/* 8 ms, four times what a crystal takes (data sheet, HSE start-up time): motors wait for stop frames meanwhile. */
#define LIMIT_OSCILLATOR (CLOCK_RESET_HZ / 125u)
#define LIMIT_READY (CLOCK_RESET_HZ / 500u)       /* 2 ms: PLL lock 0.3 ms, over-drive 0.1 ms */

static void clock_replace(volatile uint32_t *reg, uint32_t mask, uint32_t bits)
{
	*reg = (*reg & ~mask) | bits;
}

/* A ROM bootloader may have left its own clocks running. */
static bool clock_fall_back_to_hsi(void)
{
	RCC_CR |= RCC_CR_HSION;
	if (!time_wait(&RCC_CR, RCC_CR_HSIRDY, RCC_CR_HSIRDY, LIMIT_READY))
		return false;
	clock_replace(&RCC_CFGR, RCC_CFGR_SW, FIELD(RCC_CFGR_SW, SOURCE_HSI));
	if (!time_wait(&RCC_CFGR, RCC_CFGR_SWS, FIELD(RCC_CFGR_SWS, SOURCE_HSI), LIMIT_READY))
		return false;
	RCC_CR &= ~RCC_CR_PLLON;
	return time_wait(&RCC_CR, RCC_CR_PLLRDY, 0, LIMIT_READY);
}

/* Returns whether it swings. One that comes late is left off: it may stop again. */
static bool clock_start_crystal(void)
{
	RCC_CR |= RCC_CR_HSEON;
	if (!time_wait(&RCC_CR, RCC_CR_HSERDY, RCC_CR_HSERDY, LIMIT_OSCILLATOR)) {
		RCC_CR &= ~RCC_CR_HSEON;
		return false;
	}
	RCC_CR |= RCC_CR_CSSON;
	return true;
}

/* RM0431 4.1.4: PLL first, then over-drive, then its switch; only then may the PLL become the clock. */
static bool clock_start_pll(bool crystal)
{
	RCC_APB1ENR |= RCC_APB1ENR_PWREN;
	(void)RCC_APB1ENR; /* a peripheral answers two cycles after its clock bit (RM0431 5.2.12) */
	clock_replace(&PWR_CR1, PWR_CR1_VOS, FIELD(PWR_CR1_VOS, REGULATOR_SCALE_1));
	clock_replace(&RCC_PLLCFGR,
		      RCC_PLLCFGR_PLLM | RCC_PLLCFGR_PLLN | RCC_PLLCFGR_PLLP | RCC_PLLCFGR_PLLQ | RCC_PLLCFGR_PLLSRC,
		      FIELD(RCC_PLLCFGR_PLLM, crystal ? PLL_M : PLL_M_INTERNAL) | FIELD(RCC_PLLCFGR_PLLN, PLL_N) |
			      FIELD(RCC_PLLCFGR_PLLP, PLL_P / 2u - 1u) | FIELD(RCC_PLLCFGR_PLLQ, PLL_Q) |
			      (crystal ? RCC_PLLCFGR_PLLSRC : 0u));
	RCC_CR |= RCC_CR_PLLON;
	PWR_CR1 |= PWR_CR1_ODEN;
	if (!time_wait(&PWR_CSR1, PWR_CSR1_ODRDY, PWR_CSR1_ODRDY, LIMIT_READY))
		return false;
	PWR_CR1 |= PWR_CR1_ODSWEN;
	return time_wait(&PWR_CSR1, PWR_CSR1_ODSWRDY, PWR_CSR1_ODSWRDY, LIMIT_READY);
}

static bool clock_slow_flash(void)
{
	clock_replace(&FLASH_ACR, FLASH_ACR_LATENCY,
		      FIELD(FLASH_ACR_LATENCY, WAIT_STATES) | FLASH_ACR_PRFTEN | FLASH_ACR_ARTEN);
	return time_wait(&FLASH_ACR, FLASH_ACR_LATENCY, FIELD(FLASH_ACR_LATENCY, WAIT_STATES), LIMIT_READY);
}

static bool clock_switch_to_pll(void)
{
	clock_replace(&RCC_CFGR, RCC_CFGR_HPRE | RCC_CFGR_PPRE1 | RCC_CFGR_PPRE2,
		      FIELD(RCC_CFGR_PPRE1, DIVIDE_BY_4) | FIELD(RCC_CFGR_PPRE2, DIVIDE_BY_2));
	if (!time_wait(&RCC_CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY, LIMIT_READY))
		return false;
	clock_replace(&RCC_CFGR, RCC_CFGR_SW, FIELD(RCC_CFGR_SW, SOURCE_PLL));
	return time_wait(&RCC_CFGR, RCC_CFGR_SWS, FIELD(RCC_CFGR_SWS, SOURCE_PLL), LIMIT_READY);
}

bool clock_start(void)
{
	return clock_fall_back_to_hsi() && clock_start_pll(clock_start_crystal()) && clock_slow_flash() &&
	       clock_switch_to_pll();
}

void clock_peripherals(void)
{
	gpio_start();
	RCC_AHB1ENR |= RCC_AHB1ENR_DMA1EN | RCC_AHB1ENR_DMA2EN;
	RCC_APB1ENR |= RCC_APB1ENR_SPI2EN | RCC_APB1ENR_SPI3EN | RCC_APB1ENR_USART2EN | RCC_APB1ENR_USART3EN |
		       RCC_APB1ENR_UART4EN | RCC_APB1ENR_UART5EN;
	RCC_APB2ENR |= RCC_APB2ENR_TIM1EN | RCC_APB2ENR_USART1EN | RCC_APB2ENR_USART6EN | RCC_APB2ENR_ADC1EN |
		       RCC_APB2ENR_SPI1EN | RCC_APB2ENR_SYSCFGEN;
	(void)RCC_APB2ENR;
	barrier();
}

bool clock_is_exact(void)
{
	return (RCC_PLLCFGR & RCC_PLLCFGR_PLLSRC) != 0u;
}

bool clock_is_full_speed(void)
{
	return (RCC_CFGR & RCC_CFGR_SWS) == FIELD(RCC_CFGR_SWS, SOURCE_PLL);
}
