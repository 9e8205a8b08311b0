/* MSP's ports on UARTs, 8N1. Background only. */
#ifndef STM32F7_MSP_UART_H
#define STM32F7_MSP_UART_H

#include <stdbool.h>

#include "hal/stm32f7/peripherals/uart_line.h"
#include "port/hal.h"

/* Port 0..NF_MSP_PORT_COUNT - 1 begins. baud: one of NF_MSP_BAUDS. Bytes that came before are lost. */
void msp_uart_start(unsigned port, uint32_t baud);

/* The line of a port that does not begin, for something else; it is started at `baud`. */
struct uart_line *msp_uart_lend(unsigned port, uint32_t baud);

/* Serves what has come by the ports that have begun since the last call, and sends what is said unasked; waits for
 * nothing. */
void msp_uart_serve(const struct hal_handlers *handlers);

/* Sends what is left to be sent, and takes no more requests. Returns whether a bit of it is not yet on the line. */
bool msp_uart_finish(void);

#endif
