/* A log on the UART of MSP's second port, where the pilot has set it so: what it is written to is somebody else's matter.
 * Background only. */
#ifndef STM32F7_LOG_UART_H
#define STM32F7_LOG_UART_H

#include <stdint.h>

#include "port/log_device.h"

/* The line, 8N1, at one of NF_LOG_BAUDS. MSP must not have that port. */
const struct log_device *log_uart_start(uint32_t baud);

#endif
