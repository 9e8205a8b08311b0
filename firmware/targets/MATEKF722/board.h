/* MATEKF722: which pin does what. Timers, UARTs and DMA streams behind the pins are the drivers' own. */
#ifndef MATEKF722_BOARD_H
#define MATEKF722_BOARD_H

#define BOARD_ID "S7X2" /* what configurators know F72x boards by */
#define BOARD_TARGET "MATEKF722"
#define BOARD_MAKER "MTKS"

#define BOARD_HSE_HZ 8000000u
#define BOARD_MPU6500_ALIGNMENT ALIGN_CW180
#define BOARD_ICM20689_ALIGNMENT ALIGN_CW90 /* sources disagree, CW180 is said too: the pilot's setting decides */

#define BOARD_LED0 ((struct pin){GPIOB, 9}) /* active low; LED1 (PA14) is left to the debugger's SWCLK */

#define BOARD_GYRO_CS ((struct pin){GPIOC, 2})
#define BOARD_GYRO_READY ((struct pin){GPIOC, 3}) /* EXTI line 3 */
#define BOARD_GYRO_SCK ((struct pin){GPIOA, 5})   /* SPI1, AF5 */
#define BOARD_GYRO_MISO ((struct pin){GPIOA, 6})
#define BOARD_GYRO_MOSI ((struct pin){GPIOA, 7})

#define BOARD_MOTOR_COUNT 6
#define BOARD_MOTOR_1 {GPIOC, 6} /* TIM8 CH1..CH4, AF3 */
#define BOARD_MOTOR_2 {GPIOC, 7}
#define BOARD_MOTOR_3 {GPIOC, 8}
#define BOARD_MOTOR_4 {GPIOC, 9}
#define BOARD_MOTOR_5 {GPIOB, 1} /* TIM3 CH4, AF2 */
#define BOARD_MOTOR_6 {GPIOA, 8} /* TIM1 CH1, AF1 */

#define BOARD_BEEPER ((struct pin){GPIOC, 13}) /* high sounds, what the ecosystem calls inverted */

#define BOARD_VOLTS ((struct pin){GPIOC, 0}) /* ADC1 IN10 */
#define BOARD_AMPS ((struct pin){GPIOC, 4})  /* ADC1 IN14 */

#define BOARD_MSP_TX ((struct pin){GPIOA, 9}) /* USART1, AF7 */
#define BOARD_MSP_RX ((struct pin){GPIOA, 10})
#define BOARD_RECEIVER_RX ((struct pin){GPIOA, 3}) /* USART2, AF7 */

#endif
