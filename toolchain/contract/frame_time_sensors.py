"""Body axes, motor numbers, rates of samples and control steps, scales of gyro and accelerometer."""

from __future__ import annotations

from enum import IntEnum

# Body frame: x forward, y left, z up, right-handed. Rates [rad/s]: roll right +, pitch nose-down +,
# yaw left +. Motors: 1 rear right, 2 front right, 3 rear left, 4 front left; index = number - 1.
AXES = ("roll", "pitch", "yaw")
MOTOR_COUNT_MAX = 8
MOTOR_PLACES = ("rear right", "front right", "rear left", "front left")  # of the motors of a quadcopter

# --- Time ------------------------------------------------------------------------------------
GYRO_EDGE_RATE_HZ = 8000  # data-ready of every chip that is read by it, as it is set up
GYRO_RATES_HZ = (1000, 2000, 4000, 8000)  # every 8th, 4th, 2nd or each edge is read
GYRO_RATE_DEFAULT_HZ = 4000
CONTROL_RATES_HZ = (1000, 2000, 4000)


# --- Gyro ------------------------------------------------------------------------------------
class GyroChip(IntEnum):
    """Gyro chips that boards with this processor carry."""

    MPU6500 = 0  # and its bit in `gyro_kinds` of a board
    ICM20689 = 1
    ICM20602 = 2
    ICM20601 = 3
    ICM20608G = 4
    MPU9250 = 5
    MPU6000 = 6
    ICM42688P = 7
    ICM42605 = 8
    BMI270 = 9
    LSM6DSV16X = 10
    LSM6DSK320X = 11


# By chip: what it says it is. Not unique, as makers keep that in registers of their own: InvenSense in
# WHO_AM_I 0x75, Bosch in CHIP_ID 0x00, ST in WHO_AM_I 0x0F.
GYRO_IDENTITIES = (0x70, 0x98, 0x12, 0xAC, 0xAF, 0x71, 0x68, 0x47, 0x42, 0x24, 0x70, 0x75)
# By chip: the ecosystem's numbers at MSP API 1.47, which left two chips out; 0: any.
MSP_GYRO_HARDWARE = (5, 11, 8, 7, 9, 6, 4, 13, 12, 15, 17, 23)
GYRO_FILE_BYTES = 328  # of the configuration that a BMI270 needs before it measures
GYRO_FILES = {  # chips that measure only with their maker's file, which no firmware may bring along: its name
    GyroChip.BMI270: "bmi270_maximum_fifo.c of github.com/boschsensortec/BMI270_SensorAPI"
}


class Alignment(IntEnum):
    """Turns of a gyro chip on its board, clockwise seen from above; FLIP: about its y before."""

    CW0 = 0  # its x forward, y left, z up
    CW90 = 1
    CW180 = 2
    CW270 = 3
    CW0_FLIP = 4  # its x backward, y left, z down
    CW90_FLIP = 5
    CW180_FLIP = 6
    CW270_FLIP = 7


GYRO_FULL_SCALE_DEG_S = 2000  # +-2000 deg/s over int16
GYRO_COUNTS = 32768  # counts at full scale: 16.384 LSB per deg/s
GYRO_SATURATED_COUNTS = 32760  # beyond this count the rate is unknown
GYRO_BANDWIDTH_HZ = (
    250.0  # of the InvenSense chips with DLPF_CFG 0; of the others see docs/guides/board-bring-up.md
)
ACCEL_FULL_SCALE_G = 16  # +-16 g over int16
ACCEL_COUNTS = 32768
GRAVITY = 9.80665  # [m/s^2], the standard one
