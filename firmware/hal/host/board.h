/* The board that the host program pretends to be: a MATEKF722's gyro alignment, nobody's identity. */
#ifndef NF_HOST_BOARD_H
#define NF_HOST_BOARD_H

#include "firmware.h"
#include "msp.h"

extern const struct msp_identity host_identity;

/* What firmware_init takes on this board. */
struct firmware_config host_config(unsigned gyro_rate_hz);

#endif
