/* The simulated board of the host program and the library: sensors and motors in memory, gyro alignment as on a
 * MATEKF722. */
#pragma once

#include "hal/host/flash_model.h"
#include "hal/host/receiver_line.h"
#include "nf_contract.h"
#include "port/board_identity.h"
#include "port/hal.h"
#include "port/imu.h"

extern const struct board_identity host_identity;

#define HOST_GYRO_ALIGNMENT ((enum board_alignment)NF_SIM_GYRO_ALIGNMENT)
#define HOST_BANK 0u /* of images, that it stands for one of: its flash has none there */

struct host_board {
	struct receiver_line line;
	struct power_sample power;
	double control_us;             /* duration of each control step, from the simulator; 0: not given */
	uint16_t dshot[NF_MOTOR_COUNT_MAX]; /* as last written */
	size_t motor_count;
	uint16_t rotors[NF_MOTOR_COUNT_MAX]; /* words of the ESCs for the next control step */
	struct flash_model flash;
	const struct log_device *log; /* NULL: nothing takes a log */
};

/* A board with a full battery over flash of `bytes`, which must outlive it. */
void host_board_init(struct host_board *board, uint8_t *bytes);

/* Puts the policy of this build into slot A of erased flash, as a board's installation does. */
void host_board_install(uint8_t *bytes);

/* One gyro sample from rates [rad/s] and specific force [m/s^2], axes forward, right, down. */
struct imu_sample host_board_sample(const double rates_frd[3], const double force_frd[3]);

/* `board` for the core: no trace, no clock, no beeper, LED, watchdog or reset. */
struct hal host_board_hal(struct host_board *board);
