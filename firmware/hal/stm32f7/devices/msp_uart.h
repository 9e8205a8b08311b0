/* MSP on a UART: 8N1, requests in a ring, one reply buffer at a time. Background only. */
#ifndef STM32F7_MSP_UART_H
#define STM32F7_MSP_UART_H

#include <stdbool.h>

#include "hal/hal.h"

/* baud: one of NF_MSP_BAUDS. Bytes that came before are lost. */
void msp_uart_start(uint32_t baud);

/* Serves what has come since the last call; waits for nothing. While a reply is being sent requests wait in
 * the ring. */
void msp_uart_serve(const struct hal_handlers *handlers);

/* Is a reply on its way, its last bit not yet on the line? */
bool msp_uart_sending(void);

#endif
