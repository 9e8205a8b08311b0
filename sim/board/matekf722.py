"""Facts of the MATEKF722: gyro chips and how they are turned, motors' lines, and the pack that feeds it."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.sim.board.devices.gyro_chip import (
    ICM20601,
    ICM20602,
    ICM20608G,
    ICM20689,
    MPU6500,
    MPU9250,
    GyroKind,
)
from neuroflight.sim.board.devices.gyro_mount import Alignment
from neuroflight.toolchain.contract import SIM_BATTERY_MV, SIM_GYRO_ALIGNMENT


@dataclass(frozen=True)
class Gyro:
    """A gyro chip as it sits on the board."""

    chip: GyroKind
    alignment: Alignment


_CW180 = Alignment(SIM_GYRO_ALIGNMENT)
GYROS = {
    "icm20602": Gyro(ICM20602, _CW180),  # F722-STD and F722-OSD
    "mpu6500": Gyro(MPU6500, _CW180),  # boards of before
    "icm20689": Gyro(ICM20689, Alignment.CW90),  # sources disagree, CW180 is said too
    # No board with these is known: how they are turned is the pilot's to say.
    "icm20601": Gyro(ICM20601, _CW180),
    "icm20608g": Gyro(ICM20608G, _CW180),
    "mpu9250": Gyro(MPU9250, _CW180),
}
GYRO = GYROS["icm20602"]
FULL_VOLTS = SIM_BATTERY_MV / 1000  # four cells, full, at rest
# Timer and channel behind each motor's line, motors 1 to 8 (the eighth's pin is USART2's transmitter too).
MOTORS = (
    *(("TIM8", channel) for channel in range(1, 5)),
    ("TIM3", 4),
    ("TIM1", 1),
    ("TIM4", 3),
    ("TIM5", 3),
)
