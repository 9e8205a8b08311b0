/* Gyro chips: which one, how it is mounted, and one sample of it. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

/* How the chip is turned on the board, clockwise seen from above. CW0: its x forward, y left, z up. */
enum board_alignment {
	ALIGN_CW0,
	ALIGN_CW90,
	ALIGN_CW180,
	ALIGN_CW270,
	ALIGN_COUNT,
};

enum gyro_chip {
	GYRO_MPU6500,
	GYRO_ICM20689,
	GYRO_ICM20602,
	GYRO_ICM20601,
	GYRO_ICM20608G,
	GYRO_MPU9250,
	GYRO_CHIP_COUNT,
};

/* Counts in chip axes. */
struct imu_sample {
	int16_t gyro[3];     /* +-2000 deg/s over int16 */
	int16_t accel[3];    /* +-16 g over int16; all zero: not measured */
	int16_t temperature; /* the chip's own scale; 0: not measured */
	bool valid;          /* the transfer succeeded and no number is NaN */
	uint16_t lost; /* samples that the chip had before this one and that were not taken, since the last one */
};
