/* The board that the host program pretends to be: a MATEKF722's gyro alignment, nobody's identity. */
#ifndef NF_HOST_BOARD_H
#define NF_HOST_BOARD_H

#include "common/imu.h"
#include "msp/msp_identity.h"

extern const struct msp_identity host_identity;

/* How the chip that the host pretends to have is turned. */
#define HOST_GYRO_ALIGNMENT ALIGN_CW180

/* The pack that is assumed where no simulator tells of one: four cells, full, at rest. */
#define HOST_FULL_VOLTS 16.8

#endif
