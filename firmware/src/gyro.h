/* Gyro: chip counts to body rates, and the still calibration that refuses motion. */
#ifndef NF_GYRO_H
#define NF_GYRO_H

#include <stdbool.h>
#include <stdint.h>

#include "nf_err.h"

/* How the chip is turned on the board, clockwise seen from above. CW0: its x forward, y left, z up. */
enum board_alignment {
	ALIGN_CW0,
	ALIGN_CW90,
	ALIGN_CW180,
	ALIGN_CW270,
	ALIGN_COUNT,
};

struct gyro {
	enum board_alignment alignment;
	uint32_t window;          /* samples of a calibration */
	uint32_t collected;       /* samples in the sums below */
	int64_t sum[3];           /* counts, chip axes */
	int64_t sum_of_squares[3];/* counts^2 */
	float bias[3];            /* rad/s, body axes; 0 until calibrated */
	bool calibrated;
};

/* Starts uncalibrated. NF_ERR_ALIGNMENT for an unknown alignment. */
enum nf_err gyro_init(struct gyro *gyro, unsigned gyro_rate_hz, enum board_alignment alignment);

/* Takes one sample (chip axes, +-2000 deg/s over int16) and writes the body rates [rad/s].
 * Until calibrated the sample also enters the calibration: a window of NF_CALIBRATION_MS whose spread
 * or mean says motion on any axis is thrown away and a new one begins. */
void gyro_step(struct gyro *gyro, const int16_t counts[3], float rate[3]);

#endif
