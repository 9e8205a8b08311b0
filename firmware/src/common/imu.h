/* What the gyro chip says at one sample: counts in chip axes. */
#ifndef NF_IMU_H
#define NF_IMU_H

#include <stdbool.h>
#include <stdint.h>

struct imu_sample {
	int16_t gyro[3];     /* +-2000 deg/s over int16 */
	int16_t accel[3];    /* +-16 g over int16; all zero: the chip does not tell */
	int16_t temperature; /* the chip's own scale; 0: it does not tell */
	bool valid;          /* the transfer succeeded and every number is one */
};

#endif
