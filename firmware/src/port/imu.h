/* Gyro chips: how they are mounted, and one sample. Which there are: enum gyro_chip of nf_contract.h. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include "nf_contract.h"

#define ALIGN_COUNT 8u /* enum board_alignment: clockwise seen from above. CW0: the chip's x forward, y left, z up */

/* Counts in chip axes. */
struct imu_sample {
	int16_t gyro[3];     /* +-2000 deg/s over int16 */
	int16_t accel[3];    /* +-16 g over int16; all zero: not measured */
	int16_t temperature; /* the chip's own scale; 0: not measured */
	bool valid;          /* the transfer succeeded and no number is NaN */
	uint16_t lost; /* samples that the chip had before this one and that were not taken, since the last one */
};
