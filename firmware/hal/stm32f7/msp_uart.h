/* MSP on USART1: 115200 8N1, requests in a ring, one reply buffer at a time. Background only. */
#ifndef STM32F7_MSP_UART_H
#define STM32F7_MSP_UART_H

#include <stdbool.h>

#include "hal/hal.h"

void msp_uart_start(void);

/* Serves what has come since the last call; waits for nothing. While a reply is being sent requests wait in
 * the ring. */
void msp_uart_serve(const struct hal_handlers *handlers);

#endif
