"""Body axes, motor numbers, rates of samples and control steps, scales of gyro and accelerometer."""

from __future__ import annotations

from enum import IntEnum

# Body frame: x forward, y left, z up, right-handed. Rates [rad/s]: roll right +, pitch nose-down +,
# yaw left +. Motors: 1 rear right, 2 front right, 3 rear left, 4 front left; index = number - 1.
AXES = ("roll", "pitch", "yaw")
MOTOR_COUNT_MAX = 8
MOTOR_PLACES = ("rear right", "front right", "rear left", "front left")  # of the motors of a quadcopter

# --- Time ------------------------------------------------------------------------------------
GYRO_EDGE_RATE_HZ = 8000  # data-ready of the known chips with DLPF_CFG 0, whatever their divider says
GYRO_RATES_HZ = (1000, 2000, 4000, 8000)  # every 8th, 4th, 2nd or each edge is read
GYRO_RATE_DEFAULT_HZ = 4000
CONTROL_RATES_HZ = (1000, 2000, 4000)


# --- Gyro ------------------------------------------------------------------------------------
class GyroIdentity(IntEnum):
    """WHO_AM_I of the gyro chips that boards are flown with."""

    MPU6500 = 0x70
    ICM20689 = 0x98
    ICM20602 = 0x12
    ICM20601 = 0xAC
    ICM20608G = 0xAF
    MPU9250 = 0x71


# The same chips in the ecosystem's numbers at MSP API 1.47, which left two chips out; 0: any.
MSP_GYRO_HARDWARE = (5, 11, 8, 7, 9, 6)
GYRO_FULL_SCALE_DEG_S = 2000  # +-2000 deg/s over int16
GYRO_COUNTS = 32768  # counts at full scale: 16.384 LSB per deg/s
GYRO_SATURATED_COUNTS = 32760  # beyond this count the rate is unknown
GYRO_BANDWIDTH_HZ = 250.0  # of the known chips with DLPF_CFG 0
ACCEL_FULL_SCALE_G = 16  # +-16 g over int16
ACCEL_COUNTS = 32768
GRAVITY = 9.80665  # [m/s^2], the standard one
