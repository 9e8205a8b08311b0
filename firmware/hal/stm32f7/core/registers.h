/* Registers of the STM32F722 and its Cortex-M7 for this firmware, and the fields that it uses.
 *
 * Written by hand from the manuals; tests/firmware/board/test_registers.py holds every address and field
 * against sim/board/registers/registers.json, which a script extracts from the vendor's
 * description, so that an error in one shows against the other.
 *
 * Names: PERIPHERAL_REGISTER is the register (function-like where there are several instances),
 * PERIPHERAL_REGISTER_FIELD the mask of a field in place. FIELD(mask, value) puts a value there.
 * Manuals: RM0431 (STM32F72x/F73x reference manual), ARMv7-M (architecture reference manual, DDI 0403E),
 * Cortex-M7 TRM (DDI 0489). A chapter of RM0431 is named by its title, its register by its name. */
#pragma once

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define BIT(position) (1u << (position))
#define BITS(position, width) (((1u << (width)) - 1u) << (position))
/* `value` moved to where `mask` begins; keeps to the mask, so a value that is too wide is cut. */
#define FIELD(mask, value) (((uint32_t)(value) * ((mask) & -(mask))) & (mask))
/* The value that `bits` holds in `mask`. */
#define VALUE(mask, bits) (((bits) & (mask)) / ((mask) & -(mask)))

/* --- Embedded flash interface (RM0431 chapter 3) ------------------------------------------- */
#define FLASH_ACR REGISTER(0x40023C00u)
#define FLASH_ACR_LATENCY BITS(0, 4)
#define FLASH_ACR_PRFTEN BIT(8)
#define FLASH_ACR_ARTEN BIT(9)
#define FLASH_ACR_ARTRST BIT(11)
#define FLASH_KEYR REGISTER(0x40023C04u)
#define FLASH_SR REGISTER(0x40023C0Cu)
#define FLASH_SR_EOP BIT(0)
#define FLASH_SR_OPERR BIT(1)
#define FLASH_SR_WRPERR BIT(4)
#define FLASH_SR_PGAERR BIT(5)
#define FLASH_SR_PGPERR BIT(6)
#define FLASH_SR_ERSERR BIT(7)
#define FLASH_SR_BSY BIT(16)
#define FLASH_CR REGISTER(0x40023C10u)
#define FLASH_CR_PG BIT(0)
#define FLASH_CR_SER BIT(1)
#define FLASH_CR_SNB BITS(3, 4)
#define FLASH_CR_PSIZE BITS(8, 2)
#define FLASH_CR_STRT BIT(16)
#define FLASH_CR_LOCK BIT(31)
#define FLASH_OPTCR REGISTER(0x40023C14u)
#define FLASH_OPTCR_BOR_LEV BITS(2, 2)

/* --- Power controller (RM0431 chapter 4) --------------------------------------------------- */
#define PWR_CR1 REGISTER(0x40007000u)
#define PWR_CR1_VOS BITS(14, 2)
#define PWR_CR1_ODEN BIT(16)
#define PWR_CR1_ODSWEN BIT(17)
#define PWR_CSR1 REGISTER(0x40007004u)
#define PWR_CSR1_ODRDY BIT(16)
#define PWR_CSR1_ODSWRDY BIT(17)

/* --- Reset and clock control (RM0431 chapter 5) -------------------------------------------- */
#define RCC_CR REGISTER(0x40023800u)
#define RCC_CR_HSION BIT(0)
#define RCC_CR_HSIRDY BIT(1)
#define RCC_CR_HSEON BIT(16)
#define RCC_CR_HSERDY BIT(17)
#define RCC_CR_CSSON BIT(19)
#define RCC_CR_PLLON BIT(24)
#define RCC_CR_PLLRDY BIT(25)
#define RCC_PLLCFGR REGISTER(0x40023804u)
#define RCC_PLLCFGR_PLLM BITS(0, 6)
#define RCC_PLLCFGR_PLLN BITS(6, 9)
#define RCC_PLLCFGR_PLLP BITS(16, 2)
#define RCC_PLLCFGR_PLLSRC BIT(22)
#define RCC_PLLCFGR_PLLQ BITS(24, 4)
#define RCC_CFGR REGISTER(0x40023808u)
#define RCC_CFGR_SW BITS(0, 2)
#define RCC_CFGR_SWS BITS(2, 2)
#define RCC_CFGR_HPRE BITS(4, 4)
#define RCC_CFGR_PPRE1 BITS(10, 3)
#define RCC_CFGR_PPRE2 BITS(13, 3)
#define RCC_CIR REGISTER(0x4002380Cu) /* not used yet: the flag of a failed crystal */
#define RCC_CIR_CSSF BIT(7)
#define RCC_AHB1ENR REGISTER(0x40023830u)
#define RCC_AHB1ENR_GPIOAEN BIT(0)
#define RCC_AHB1ENR_GPIOBEN BIT(1)
#define RCC_AHB1ENR_GPIOCEN BIT(2)
#define RCC_AHB1ENR_GPIODEN BIT(3)
#define RCC_AHB1ENR_GPIOEEN BIT(4)
#define RCC_AHB1ENR_DMA1EN BIT(21)
#define RCC_AHB1ENR_DMA2EN BIT(22)
#define RCC_AHB2ENR REGISTER(0x40023834u)
#define RCC_AHB2ENR_OTGFSEN BIT(7)
#define RCC_APB1ENR REGISTER(0x40023840u)
#define RCC_APB1ENR_TIM5EN BIT(3)
#define RCC_APB1ENR_SPI2EN BIT(14)
#define RCC_APB1ENR_SPI3EN BIT(15)
#define RCC_APB1ENR_USART2EN BIT(17)
#define RCC_APB1ENR_USART3EN BIT(18)
#define RCC_APB1ENR_UART4EN BIT(19)
#define RCC_APB1ENR_UART5EN BIT(20)
#define RCC_APB1ENR_PWREN BIT(28)
#define RCC_APB2ENR REGISTER(0x40023844u)
#define RCC_APB2ENR_TIM1EN BIT(0)
#define RCC_APB2ENR_USART1EN BIT(4)
#define RCC_APB2ENR_USART6EN BIT(5)
#define RCC_APB2ENR_ADC1EN BIT(8)
#define RCC_APB2ENR_SPI1EN BIT(12)
#define RCC_APB2ENR_SYSCFGEN BIT(14)
#define RCC_CSR REGISTER(0x40023874u)
#define RCC_CSR_RMVF BIT(24)
#define RCC_CSR_BORRSTF BIT(25)
#define RCC_CSR_PORRSTF BIT(27)
#define RCC_CSR_SFTRSTF BIT(28)
#define RCC_CSR_WDGRSTF BIT(29)

/* --- General-purpose I/Os (RM0431 chapter 6); two, one or four bits a pin ------------------- */
#define GPIOA 0x40020000u
#define GPIOB 0x40020400u
#define GPIOC 0x40020800u
#define GPIOD 0x40020C00u
#define GPIOE 0x40021000u
#define GPIO_MODER(port) REGISTER((port) + 0x00u)
#define GPIO_OTYPER(port) REGISTER((port) + 0x04u)
#define GPIO_OSPEEDR(port) REGISTER((port) + 0x08u)
#define GPIO_PUPDR(port) REGISTER((port) + 0x0Cu)
#define GPIO_IDR(port) REGISTER((port) + 0x10u)
#define GPIO_BSRR(port) REGISTER((port) + 0x18u)
#define GPIO_AFRL(port) REGISTER((port) + 0x20u)
#define GPIO_AFRH(port) REGISTER((port) + 0x24u)

/* --- System configuration controller (RM0431 chapter 7) ------------------------------------ */
#define SYSCFG_EXTICR(n) REGISTER(0x40013804u + 4u * (n)) /* n 1 to 4: port of four lines each, 4 bits a line */

/* --- Direct memory access controller (RM0431 chapter 8): stream s of a controller ----------- */
#define DMA1 0x40026000u
#define DMA2 0x40026400u
#define DMA_LISR(dma) REGISTER((dma) + 0x00u)
#define DMA_LISR_HTIF0 BIT(4)
#define DMA_LISR_TCIF0 BIT(5)
#define DMA_LISR_TCIF1 BIT(11)
#define DMA_LISR_TCIF2 BIT(21)
#define DMA_LISR_TCIF3 BIT(27)
#define DMA_HISR(dma) REGISTER((dma) + 0x04u)
#define DMA_LIFCR(dma) REGISTER((dma) + 0x08u)
#define DMA_LIFCR_CFEIF0 BIT(0)
#define DMA_LIFCR_CDMEIF0 BIT(2)
#define DMA_LIFCR_CTEIF0 BIT(3)
#define DMA_LIFCR_CHTIF0 BIT(4)
#define DMA_LIFCR_CTCIF0 BIT(5)
#define DMA_HIFCR(dma) REGISTER((dma) + 0x0Cu)
#define DMA_SCR(dma, s) REGISTER((dma) + 0x10u + 0x18u * (s))
#define DMA_SCR_EN BIT(0)
#define DMA_SCR_TEIE BIT(2)
#define DMA_SCR_TCIE BIT(4)
#define DMA_SCR_DIR BITS(6, 2)
#define DMA_SCR_CIRC BIT(8)
#define DMA_SCR_MINC BIT(10)
#define DMA_SCR_PSIZE BITS(11, 2)
#define DMA_SCR_MSIZE BITS(13, 2)
#define DMA_SCR_PL BITS(16, 2)
#define DMA_SCR_CHSEL BITS(25, 4)
#define DMA_SNDTR(dma, s) REGISTER((dma) + 0x14u + 0x18u * (s))
#define DMA_SNDTR_NDT BITS(0, 16)
#define DMA_SPAR(dma, s) REGISTER((dma) + 0x18u + 0x18u * (s))
#define DMA_SM0AR(dma, s) REGISTER((dma) + 0x1Cu + 0x18u * (s))

/* --- Extended interrupts and events controller (RM0431 chapter EXTI) ----------------------- */
#define EXTI_IMR REGISTER(0x40013C00u) /* a bit each line, in all of them */
#define EXTI_RTSR REGISTER(0x40013C08u)
#define EXTI_PR REGISTER(0x40013C14u)

/* --- Analog-to-digital converter (RM0431 chapter ADC); ADC_CCR is common to all three ------- */
#define ADC1_SR REGISTER(0x40012000u)
#define ADC1_SR_OVR BIT(5)
#define ADC1_CR2 REGISTER(0x40012008u)
#define ADC1_CR2_ADON BIT(0)
#define ADC1_CR2_CONT BIT(1)
#define ADC1_CR2_DMA BIT(8)
#define ADC1_CR2_DDS BIT(9)
#define ADC1_CR2_SWSTART BIT(30)
#define ADC1_CR1 REGISTER(0x40012004u)
#define ADC1_CR1_SCAN BIT(8)
#define ADC1_SMPR1 REGISTER(0x4001200Cu) /* of channels 10 to 18, 3 bits each */
#define ADC1_SMPR2 REGISTER(0x40012010u) /* of 0 to 9 */
#define ADC1_SQR1 REGISTER(0x4001202Cu)
#define ADC1_SQR1_L BITS(20, 4)
#define ADC1_SQR3 REGISTER(0x40012034u)
#define ADC1_SQR3_SQ1 BITS(0, 5)
#define ADC1_SQR3_SQ2 BITS(5, 5)
#define ADC1_DR REGISTER(0x4001204Cu)
#define ADC_CCR REGISTER(0x40012304u)
#define ADC_CCR_ADCPRE BITS(16, 2)

/* --- Independent watchdog (RM0431 chapter IWDG) -------------------------------------------- */
#define IWDG_KR REGISTER(0x40003000u)
#define IWDG_PR REGISTER(0x40003004u)
#define IWDG_PR_PR BITS(0, 3)
#define IWDG_RLR REGISTER(0x40003008u)
#define IWDG_RLR_RL BITS(0, 12)
#define IWDG_SR REGISTER(0x4000300Cu)
#define IWDG_SR_PVU BIT(0)
#define IWDG_SR_RVU BIT(1)

/* --- Timers (RM0431 chapters TIM1/TIM8 and TIM2/TIM3/TIM4/TIM5) ------------------------------ */
#define TIM1 0x40010000u
#define TIM5 0x40000C00u /* its counter has 32 bits */
#define TIM_CR1(timer) REGISTER((timer) + 0x00u)
#define TIM_CR1_CEN BIT(0)
#define TIM_CR2(timer) REGISTER((timer) + 0x04u)
#define TIM_CR2_CCDS BIT(3)
#define TIM_DIER(timer) REGISTER((timer) + 0x0Cu)
#define TIM_DIER_UIE BIT(0)
#define TIM_DIER_CC1DE BIT(9) /* of channel 1; those of 2 to 4 follow */
#define TIM_SR(timer) REGISTER((timer) + 0x10u)
#define TIM_EGR(timer) REGISTER((timer) + 0x14u)
#define TIM_EGR_UG BIT(0)
#define TIM_CNT(timer) REGISTER((timer) + 0x24u)
#define TIM_PSC(timer) REGISTER((timer) + 0x28u)
#define TIM_ARR(timer) REGISTER((timer) + 0x2Cu)

/* --- Serial peripheral interface (RM0431 chapter SPI/I2S) ---------------------------------- */
#define SPI1 0x40013000u
#define SPI2 0x40003800u
#define SPI3 0x40003C00u
#define SPI_CR1(spi) REGISTER((spi) + 0x00u)
#define SPI_CR1_CPHA BIT(0)
#define SPI_CR1_CPOL BIT(1)
#define SPI_CR1_MSTR BIT(2)
#define SPI_CR1_BR BITS(3, 3)
#define SPI_CR1_SPE BIT(6)
#define SPI_CR1_SSI BIT(8)
#define SPI_CR1_SSM BIT(9)
#define SPI_CR2(spi) REGISTER((spi) + 0x04u)
#define SPI_CR2_RXDMAEN BIT(0)
#define SPI_CR2_TXDMAEN BIT(1)
#define SPI_CR2_DS BITS(8, 4)
#define SPI_CR2_FRXTH BIT(12)
#define SPI_SR(spi) REGISTER((spi) + 0x08u)
#define SPI_SR_RXNE BIT(0)
#define SPI_SR_TXE BIT(1)
#define SPI_SR_BSY BIT(7)
#define SPI_SR_FRLVL BITS(9, 2)
#define SPI_SR_FTLVL BITS(11, 2)
#define SPI_DR(spi) REGISTER((spi) + 0x0Cu)

/* --- Universal asynchronous receiver transmitter (RM0431 chapter USART) -------------------- */
#define USART1 0x40011000u
#define USART2 0x40004400u
#define USART3 0x40004800u
#define UART4 0x40004C00u
#define UART5 0x40005000u
#define USART6 0x40011400u
#define USART_CR1(uart) REGISTER((uart) + 0x00u)
#define USART_CR1_UE BIT(0)
#define USART_CR1_RE BIT(2)
#define USART_CR1_TE BIT(3)
#define USART_CR1_PCE BIT(10)
#define USART_CR1_M0 BIT(12)
#define USART_CR2(uart) REGISTER((uart) + 0x04u)
#define USART_CR2_STOP BITS(12, 2)
#define USART_CR2_RXINV BIT(16)
#define USART_CR3(uart) REGISTER((uart) + 0x08u)
#define USART_CR3_DMAR BIT(6)
#define USART_CR3_DMAT BIT(7)
#define USART_CR3_OVRDIS BIT(12)
#define USART_BRR(uart) REGISTER((uart) + 0x0Cu)
#define USART_ISR(uart) REGISTER((uart) + 0x1Cu)
#define USART_ISR_PE BIT(0)
#define USART_ISR_FE BIT(1)
#define USART_ISR_IDLE BIT(4)
#define USART_ISR_TC BIT(6)
#define USART_ICR(uart) REGISTER((uart) + 0x20u)
#define USART_ICR_PECF BIT(0)
#define USART_ICR_FECF BIT(1)
#define USART_ICR_IDLECF BIT(4)
#define USART_RDR(uart) REGISTER((uart) + 0x24u)
#define USART_TDR(uart) REGISTER((uart) + 0x28u)

/* --- USB on-the-go full-speed (RM0431 chapter OTG_FS/OTG_HS) as a device; endpoint n's registers have it as argument --- */
#define OTG_GOTGCTL REGISTER(0x50000000u)
#define OTG_GOTGCTL_BVALOEN BIT(6)
#define OTG_GOTGCTL_BVALOVAL BIT(7)
#define OTG_GUSBCFG REGISTER(0x5000000Cu)
#define OTG_GUSBCFG_TRDT BITS(10, 4)
#define OTG_GUSBCFG_FDMOD BIT(30)
#define OTG_GRSTCTL REGISTER(0x50000010u)
#define OTG_GRSTCTL_CSRST BIT(0)
#define OTG_GRSTCTL_RXFFLSH BIT(4)
#define OTG_GRSTCTL_TXFFLSH BIT(5)
#define OTG_GRSTCTL_TXFNUM BITS(6, 5)
#define OTG_GRSTCTL_AHBIDL BIT(31)
#define OTG_GINTSTS REGISTER(0x50000014u)
#define OTG_GINTSTS_CMOD BIT(0)
#define OTG_GINTSTS_RXFLVL BIT(4)
#define OTG_GINTSTS_USBSUSP BIT(11)
#define OTG_GINTSTS_USBRST BIT(12)
#define OTG_GINTSTS_ENUMDNE BIT(13)
#define OTG_GINTSTS_IEPINT BIT(18)
#define OTG_GRXSTSP REGISTER(0x50000020u)
#define OTG_GRXSTSP_EPNUM BITS(0, 4)
#define OTG_GRXSTSP_BCNT BITS(4, 11)
#define OTG_GRXSTSP_PKTSTS BITS(17, 4)
#define OTG_GRXFSIZ REGISTER(0x50000024u)
#define OTG_GRXFSIZ_RXFD BITS(0, 16)
#define OTG_DIEPTXF0 REGISTER(0x50000028u)
#define OTG_DIEPTXF0_TX0FSA BITS(0, 16)
#define OTG_DIEPTXF0_TX0FD BITS(16, 16)
#define OTG_GCCFG REGISTER(0x50000038u)
#define OTG_GCCFG_PWRDWN BIT(16)
#define OTG_DIEPTXF(n) REGISTER(0x50000100u + 4u * (n)) /* n from 1 on */
#define OTG_DIEPTXF_INEPTXSA BITS(0, 16)
#define OTG_DIEPTXF_INEPTXFD BITS(16, 16)
#define OTG_DCFG REGISTER(0x50000800u)
#define OTG_DCFG_DSPD BITS(0, 2)
#define OTG_DCFG_DAD BITS(4, 7)
#define OTG_DCTL REGISTER(0x50000804u)
#define OTG_DCTL_SDIS BIT(1)
#define OTG_DCTL_CGINAK BIT(8)
#define OTG_DSTS REGISTER(0x50000808u)
#define OTG_DSTS_SUSPSTS BIT(0)
#define OTG_DIEPMSK REGISTER(0x50000810u)
#define OTG_DIEPMSK_XFRCM BIT(0)
#define OTG_DAINTMSK REGISTER(0x5000081Cu)
#define OTG_DAINTMSK_IEPM BITS(0, 16)
#define OTG_DIEPCTL(n) REGISTER(0x50000900u + 0x20u * (n))
#define OTG_DIEPCTL_USBAEP BIT(15)
#define OTG_DIEPCTL_EPTYP BITS(18, 2)
#define OTG_DIEPCTL_STALL BIT(21)
#define OTG_DIEPCTL_TXFNUM BITS(22, 4)
#define OTG_DIEPCTL_CNAK BIT(26)
#define OTG_DIEPCTL_SNAK BIT(27)
#define OTG_DIEPCTL_EPDIS BIT(30)
#define OTG_DIEPCTL_EPENA BIT(31)
#define OTG_DIEPINT(n) REGISTER(0x50000908u + 0x20u * (n))
#define OTG_DIEPINT_XFRC BIT(0)
#define OTG_DIEPINT_EPDISD BIT(1)
#define OTG_DIEPINT_INEPNE BIT(6)
#define OTG_DIEPTSIZ(n) REGISTER(0x50000910u + 0x20u * (n))
#define OTG_DOEPCTL(n) REGISTER(0x50000B00u + 0x20u * (n))
#define OTG_DOEPCTL_USBAEP BIT(15)
#define OTG_DOEPCTL_EPTYP BITS(18, 2)
#define OTG_DOEPCTL_STALL BIT(21)
#define OTG_DOEPCTL_CNAK BIT(26)
#define OTG_DOEPCTL_SNAK BIT(27)
#define OTG_DOEPCTL_EPENA BIT(31)
#define OTG_DOEPTSIZ(n) REGISTER(0x50000B10u + 0x20u * (n))
#define OTG_PCGCCTL REGISTER(0x50000E00u)
#define OTG_FIFO(n) REGISTER(0x50001000u + 0x1000u * (n)) /* written: to be sent by endpoint n; 0 read: what came */

/* --- System timer and interrupt controller (ARMv7-M B3.3, B3.4) ---------------------------- */
#define SYST_CSR REGISTER(0xE000E010u)
#define SYST_CSR_ENABLE BIT(0)
#define SYST_CSR_TICKINT BIT(1)
#define SYST_CSR_CLKSOURCE BIT(2)
#define SYST_CSR_COUNTFLAG BIT(16)
#define SYST_RVR REGISTER(0xE000E014u)
#define SYST_CVR REGISTER(0xE000E018u)
#define NVIC_ISER(word) REGISTER(0xE000E100u + 4u * (word)) /* 32 interrupts a word */
#define NVIC_IPR(word) REGISTER(0xE000E400u + 4u * (word))  /* 4 interrupts a word */

/* --- System control block (ARMv7-M B3.2), caches (B3.2, Cortex-M7 TRM 4.4) ----------------- */
#define SCB_ICSR REGISTER(0xE000ED04u)
#define SCB_ICSR_VECTACTIVE BITS(0, 9)
#define SCB_ICSR_PENDSVSET BIT(28)
#define SCB_VTOR REGISTER(0xE000ED08u)
#define SCB_AIRCR REGISTER(0xE000ED0Cu)
#define SCB_AIRCR_SYSRESETREQ BIT(2)
#define SCB_AIRCR_VECTKEY BITS(16, 16)
#define SCB_CCR REGISTER(0xE000ED14u)
#define SCB_CCR_UNALIGN_TRP BIT(3)
#define SCB_CCR_DIV_0_TRP BIT(4)
#define SCB_CCR_DC BIT(16)
#define SCB_CCR_IC BIT(17)
#define SCB_SHPR3 REGISTER(0xE000ED20u)
#define SCB_SHPR3_PRI_14 BITS(16, 8)
#define SCB_SHPR3_PRI_15 BITS(24, 8)
#define SCB_SHCSR REGISTER(0xE000ED24u)
#define SCB_SHCSR_MEMFAULTENA BIT(16)
#define SCB_SHCSR_BUSFAULTENA BIT(17)
#define SCB_SHCSR_USGFAULTENA BIT(18)
#define SCB_CFSR REGISTER(0xE000ED28u)
#define SCB_HFSR REGISTER(0xE000ED2Cu)
#define SCB_MMFAR REGISTER(0xE000ED34u)
#define SCB_BFAR REGISTER(0xE000ED38u)
#define SCB_CCSIDR REGISTER(0xE000ED80u)
#define SCB_CCSIDR_ASSOCIATIVITY BITS(3, 10)
#define SCB_CCSIDR_NUMSETS BITS(13, 15)
#define SCB_CSSELR REGISTER(0xE000ED84u)
#define SCB_CPACR REGISTER(0xE000ED88u)
#define SCB_CPACR_CP10 BITS(20, 2)
#define SCB_CPACR_CP11 BITS(22, 2)
#define SCB_ICIALLU REGISTER(0xE000EF50u)
#define SCB_DCISW REGISTER(0xE000EF60u)
#define SCB_DCCISW REGISTER(0xE000EF74u)

/* --- Memory protection unit (ARMv7-M B3.5) ------------------------------------------------- */
#define MPU_CTRL REGISTER(0xE000ED94u)
#define MPU_CTRL_ENABLE BIT(0)
#define MPU_CTRL_PRIVDEFENA BIT(2)
#define MPU_RNR REGISTER(0xE000ED98u)
#define MPU_RBAR REGISTER(0xE000ED9Cu)
#define MPU_RASR REGISTER(0xE000EDA0u)
#define MPU_RASR_ENABLE BIT(0)
#define MPU_RASR_SIZE BITS(1, 5)
#define MPU_RASR_TEX BITS(19, 3)
#define MPU_RASR_AP BITS(24, 3)
#define MPU_RASR_XN BIT(28)

/* --- Debug: the cycle counter (ARMv7-M C1.6, C1.8) ----------------------------------------- */
#define DCB_DEMCR REGISTER(0xE000EDFCu)
#define DCB_DEMCR_TRCENA BIT(24)
#define DWT_CTRL REGISTER(0xE0001000u)
#define DWT_CTRL_CYCCNTENA BIT(0)
#define DWT_CYCCNT REGISTER(0xE0001004u)
#define DWT_LAR REGISTER(0xE0001FB0u)

/* --- Debug: what stands still while a debugger halts the core (RM0431 chapter DBGMCU) ------- */
#define DBGMCU_APB1FZ REGISTER(0xE0042008u)
#define DBGMCU_APB1FZ_DBG_IWDG_STOP BIT(12)

/* --- Device electronic signature (RM0431 chapter of that name): 96 bits in three words ------ */
#define SIGNATURE_UID(word) REGISTER(0x1FF07A10u + 4u * (word))

/* --- Interrupt numbers in use (RM0431 chapter NVIC, vector table) -------------------------- */
#define IRQ_EXTI0 6u
#define IRQ_EXTI1 7u
#define IRQ_EXTI2 8u
#define IRQ_EXTI3 9u
#define IRQ_EXTI4 10u
#define IRQ_DMA1_STREAM0 11u
#define IRQ_DMA1_STREAM1 12u
#define IRQ_DMA1_STREAM2 13u
#define IRQ_DMA1_STREAM3 14u
#define IRQ_DMA1_STREAM4 15u
#define IRQ_DMA1_STREAM5 16u
#define IRQ_DMA1_STREAM6 17u
#define IRQ_EXTI9_5 23u
#define IRQ_EXTI15_10 40u
#define IRQ_DMA1_STREAM7 47u
#define IRQ_TIM5 50u
#define IRQ_DMA2_STREAM0 56u
#define IRQ_DMA2_STREAM1 57u
#define IRQ_DMA2_STREAM2 58u
#define IRQ_DMA2_STREAM3 59u
#define IRQ_DMA2_STREAM4 60u
#define IRQ_DMA2_STREAM5 68u
#define IRQ_DMA2_STREAM6 69u
#define IRQ_DMA2_STREAM7 70u
#define IRQ_COUNT 104u /* the table's last number is SDMMC2, 103 */
