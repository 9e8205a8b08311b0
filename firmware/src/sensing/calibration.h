/* Still calibration: the gyro's mean over a window in which nothing moved. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

struct calibration {
	uint32_t window;           /* samples */
	uint32_t collected;        /* samples in the sums below */
	int64_t sum[3];            /* counts, chip axes */
	int64_t sum_of_squares[3]; /* counts^2 */
};

/* Prepares windows of NF_CALIBRATION_MS. */
void calibration_init(struct calibration *calibration, unsigned gyro_rate_hz);

/* A window begins. */
void calibration_restart(struct calibration *calibration);

/* One sample [counts]. The window that it completes is discarded if spread or mean exceed the stillness limits on any
 * axis; else returns true, once, with the means [counts]. Either way a new window begins. calm: the limit of the spread is
 * NF_CALIBRATION_CALM_DEG_S, not NF_CALIBRATION_MOTION_DEG_S. */
bool calibration_step(struct calibration *calibration, const int16_t counts[3], bool calm, float mean[3]);
