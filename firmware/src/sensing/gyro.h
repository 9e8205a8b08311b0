/* Gyro: chip counts to body rates, calibration at rest, and the health of the samples. */
#pragma once

#include "nf_contract.h"
#include "port/imu.h"
#include "sensing/calibration.h"

struct gyro {
	enum board_alignment alignment; /* of the chip on the board */
	struct calibration calibration;
	float bias[3];            /* rad/s, body axes; 0 until calibrated */
	bool calibrated;
	enum nf_gyro_health health; /* what the last gyro_step returned */
	struct imu_sample last;   /* the last good one; before it, zero and not valid */
	int32_t jump;             /* counts, that a good sample may lie away from the one before */
	uint32_t bad;             /* samples since the last good one, at most bad_after */
	uint32_t bad_after;       /* number of bad samples in a row that is more than a glitch */
	uint32_t saturated; /* samples in a row at an end of the range, bad ones left out; at most saturated_after */
	uint32_t saturated_after; /* number of them that no flight takes */
	uint32_t same; /* good samples that repeated the one before, at most stuck_after */
	bool rests;               /* the motors stand: the bias is found, or follows */
	bool turned;              /* the board by its maker, or in the aircraft: by `turn` */
	float turn[3][3];         /* from the board's axes to the body's */
	uint32_t stuck_after; /* number of repetitions that a working chip does not produce; 0: no limit */
};

/* Starts uncalibrated, at rest and in good health. stuck_ms: the setting. NF_ERR_ALIGNMENT for an unknown alignment. */
enum nf_err gyro_init(struct gyro *gyro, unsigned gyro_rate_hz, enum board_alignment alignment, unsigned stuck_ms);

/* How the board is turned in the aircraft, -180 to 180 each: first by yaw (clockwise seen from above), then pitched (its
 * arrow upwards), then rolled (its left side downwards), each about the board's own axes. Each call turns what the calls
 * before it have made of the board: the maker's turn first, then the pilot's. Not turned until called. */
void gyro_board_init(struct gyro *gyro, float roll_deg, float pitch_deg, float yaw_deg);

/* Takes one sample and writes the body rates [rad/s].
 *
 * A bad sample is one that is not valid, or lies further from the last good one than the chip's low-pass can move;
 * the last good one stands in for it (before the first: 0 rad/s). One that has an axis at the end of its range is good:
 * the aircraft turns at least so fast. Returns the present health: INVALID from NF_GYRO_BAD_MS of bad samples in a row
 * on, STUCK from stuck_ms of samples on that are the same in every word, SATURATED while an axis of the last good
 * sample is at the end of its range, and GOOD again with the first that is none of it. NF_GYRO_HEALTH_SILENT is not
 * this module's: there is no sample to say it.
 *
 * At rest each good sample also enters the calibration. A window of NF_CALIBRATION_MS whose spread or mean exceeds the
 * stillness limits on any axis is discarded and a new one begins; so is one with a bad, saturated or stuck sample. The
 * first window that is not gives the bias. From then on each one whose mean is within NF_CALIBRATION_DRIFT_DEG_S of it
 * moves it there, by NF_CALIBRATION_STEP_DEG_S at most. */
enum nf_gyro_health gyro_step(struct gyro *gyro, const struct imu_sample *sample, float rate[3]);

/* Do the motors stand? A window begins with their rest. */
void gyro_rest(struct gyro *gyro, bool rests);

/* Returns whether an axis has been saturated for NF_GYRO_SATURATED_MS without a good sample below the limit. */
bool gyro_railed(const struct gyro *gyro);

/* Specific force of the last good sample [m/s^2], body axes: 9.81 upwards at rest. All zero: the chip does not measure
 * it. */
void gyro_acceleration(const struct gyro *gyro, float acceleration[3]);

/* Temperature of the chip at the last good sample [deg C]. */
float gyro_temperature_c(const struct gyro *gyro, enum gyro_chip chip);
