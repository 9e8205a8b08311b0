"""Facts of the MATEKF722: how its gyro chip is turned, its motors' lines, and the pack that feeds it."""

from __future__ import annotations

from sim.board.devices.gyro_mount import Alignment
from toolchain.contract import SIM_BATTERY_MV, SIM_GYRO_ALIGNMENT

ALIGNMENT = Alignment(SIM_GYRO_ALIGNMENT)  # of the MPU6500
FULL_VOLTS = SIM_BATTERY_MV / 1000  # four cells, full, at rest
# Timer and channel behind each motor's line, motors 1 to 8 (the eighth's pin is USART2's transmitter too).
MOTORS = (
    *(("TIM8", channel) for channel in range(1, 5)),
    ("TIM3", 4),
    ("TIM1", 1),
    ("TIM4", 3),
    ("TIM5", 3),
)
