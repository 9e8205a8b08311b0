/* MATEKF722: which pin does what, and which timer, UART and DMA stream is behind it. Names of gpio.h, registers.h,
 * clock.h and dma.h: whoever uses one of these includes what it is made of. */
#pragma once

#define BOARD_ID "S7X2" /* what configurators know F72x boards by */
#define BOARD_TARGET "MATEKF722"
#define BOARD_MAKER "MTKS"
#define BOARD_OSD_CHIP true /* MAX7456 on SPI2, which nothing drives yet */

#define BOARD_HSE_HZ 8000000u
/* F722-STD and F722-OSD carry an ICM-20602. That is turned by 180 degrees, and so is the MPU-6500 of older boards. Of the
 * ICM-20689 sources say 90 and 180 degrees, and of other chips nobody tells: there the pilot's setting decides. */
#define BOARD_GYRO_ALIGNMENT ALIGN_CW180
#define BOARD_ICM20689_ALIGNMENT ALIGN_CW90
#define BOARD_ALIGNMENT_DISPUTED(chip) ((chip) != GYRO_ICM20602 && (chip) != GYRO_MPU6500)

/* RCC enable bits of the ports, timers and UARTs below. */
#define BOARD_PORT_CLOCKS (RCC_AHB1ENR_GPIOAEN | RCC_AHB1ENR_GPIOBEN | RCC_AHB1ENR_GPIOCEN)
#define BOARD_APB1_CLOCKS (RCC_APB1ENR_TIM3EN | RCC_APB1ENR_SPI3EN | RCC_APB1ENR_USART2EN | RCC_APB1ENR_USART3EN)
#define BOARD_APB2_CLOCKS (RCC_APB2ENR_TIM1EN | RCC_APB2ENR_TIM8EN | RCC_APB2ENR_USART1EN)

#define BOARD_LED0 ((struct pin){ GPIOB, 9 }) /* active low; LED1 (PA14) is left to the debugger's SWCLK */

#define BOARD_GYRO_CS ((struct pin){ GPIOC, 2 })
#define BOARD_GYRO_READY ((struct pin){ GPIOC, 3 }) /* EXTI line 3 */
#define BOARD_GYRO_SCK ((struct pin){ GPIOA, 5 })   /* SPI1, AF5 */
#define BOARD_GYRO_MISO ((struct pin){ GPIOA, 6 })
#define BOARD_GYRO_MOSI ((struct pin){ GPIOA, 7 })

#define BOARD_MOTOR_COUNT 6
// clang-format off
#define BOARD_MOTOR_PINS /* pin and alternate function of each motor */               \
	{{GPIOC, 6}, 3}, {{GPIOC, 7}, 3}, {{GPIOC, 8}, 3}, {{GPIOC, 9}, 3}, /* TIM8 */ \
	{{GPIOB, 1}, 2},                                                    /* TIM3 */ \
	{{GPIOA, 8}, 1}                                                     /* TIM1 */
/* First motor, timer, channel, clock, DMA stream and request, has a main output switch; the macros are those of
 * motors.c. TIM1's update request comes by the stream of the MSP line; its channel's, moved to the update by CCDS, has
 * a free one. */
#define BOARD_MOTOR_BANKS                                                                                         \
	MOTOR_BANK_OF_4(0, TIM8, CLOCK_TIM8_HZ, ((struct dma_stream){DMA2, 1, 7}), TIM_DIER_UDE, true),           \
	MOTOR_BANK_OF_1(4, TIM3, 4, CLOCK_TIM3_HZ, ((struct dma_stream){DMA1, 2, 5}), TIM_DIER_UDE, false),       \
	MOTOR_BANK_OF_1(5, TIM1, 1, CLOCK_TIM8_HZ, ((struct dma_stream){DMA2, 6, 0}), TIM_DIER_CC1DE, true)
// clang-format on

#define BOARD_BEEPER ((struct pin){ GPIOC, 13 }) /* high sounds, what the ecosystem calls inverted */

#define BOARD_VOLTS ((struct pin){ GPIOC, 0 }) /* ADC1 IN10 */
#define BOARD_AMPS ((struct pin){ GPIOC, 4 })  /* ADC1 IN14 */

#define BOARD_MSP_UART USART1
#define BOARD_MSP_UART_HZ CLOCK_APB2_HZ
#define BOARD_MSP_AF 7u
#define BOARD_MSP_TX ((struct pin){ GPIOA, 9 })
#define BOARD_MSP_RX ((struct pin){ GPIOA, 10 })
#define BOARD_MSP_DMA_RX ((struct dma_stream){ DMA2, 5, 4 })
#define BOARD_MSP_DMA_TX ((struct dma_stream){ DMA2, 7, 4 })

/* The second one, where the pilot has set it so; else it may take a log. */
#define BOARD_MSP2_UART USART3
#define BOARD_MSP2_UART_HZ CLOCK_APB1_HZ
#define BOARD_MSP2_AF 7u
#define BOARD_MSP2_TX ((struct pin){ GPIOC, 10 })
#define BOARD_MSP2_RX ((struct pin){ GPIOC, 11 })
#define BOARD_MSP2_DMA_RX ((struct dma_stream){ DMA1, 1, 4 })
#define BOARD_MSP2_DMA_TX ((struct dma_stream){ DMA1, 3, 4 })

#define BOARD_USB_DM ((struct pin){ GPIOA, 11 })
#define BOARD_USB_DP ((struct pin){ GPIOA, 12 })
#define BOARD_USB_AF 10u
#define BOARD_USB_VBUS ((struct pin){ GPIOB, 12 }) /* the cable's supply, divided */

#define BOARD_CARD_SPI SPI3
#define BOARD_CARD_AF 6u
#define BOARD_CARD_CS ((struct pin){ GPIOC, 1 })
#define BOARD_CARD_SCK ((struct pin){ GPIOB, 3 })
#define BOARD_CARD_MISO ((struct pin){ GPIOB, 4 })
#define BOARD_CARD_MOSI ((struct pin){ GPIOB, 5 })
#define BOARD_CARD_DMA_RX ((struct dma_stream){ DMA1, 0, 0 })
#define BOARD_CARD_DMA_TX ((struct dma_stream){ DMA1, 7, 0 })

#define BOARD_RECEIVER_UART USART2
#define BOARD_RECEIVER_UART_HZ CLOCK_APB1_HZ
#define BOARD_RECEIVER_AF 7u
#define BOARD_RECEIVER_RX ((struct pin){ GPIOA, 3 })
#define BOARD_RECEIVER_DMA_RX ((struct dma_stream){ DMA1, 5, 4 })
