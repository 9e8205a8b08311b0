"""Facts of the MATEKF722: gyro chips and how they are turned, motors' lines, and the pack that feeds it."""

from __future__ import annotations

from dataclasses import dataclass

from sim.board.devices.gyro_chip import ICM20689, MPU6500, GyroKind
from sim.board.devices.gyro_mount import Alignment
from toolchain.contract import SIM_BATTERY_MV, SIM_GYRO_ALIGNMENT


@dataclass(frozen=True)
class Gyro:
    """A gyro chip as it sits on the board."""

    chip: GyroKind
    alignment: Alignment


GYROS = {
    "mpu6500": Gyro(MPU6500, Alignment(SIM_GYRO_ALIGNMENT)),
    "icm20689": Gyro(ICM20689, Alignment.CW90),  # sources disagree, CW180 is said too
}
GYRO = GYROS["mpu6500"]  # of most boards
FULL_VOLTS = SIM_BATTERY_MV / 1000  # four cells, full, at rest
# Timer and channel behind each motor's line, motors 1 to 8 (the eighth's pin is USART2's transmitter too).
MOTORS = (
    *(("TIM8", channel) for channel in range(1, 5)),
    ("TIM3", 4),
    ("TIM1", 1),
    ("TIM4", 3),
    ("TIM5", 3),
)
