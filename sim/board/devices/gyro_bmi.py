"""Bosch's BMI270 before its configuration file is in it: it tells what it is, and measures nothing.

Sources: Bosch's BMI270_SensorAPI (registers, the dummy byte of a read) and its users, whose chips without the
file gave zeros, whatever they wrote.
"""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.gyro_chip import GyroChip, GyroKind, Registers, Setup


@dataclass(frozen=True, kw_only=True)
class BmiKind(GyroKind):
    """A chip of this family."""

    told_at: int = 0x00
    data: int = 0x0C
    order: tuple[int, ...] = (0, 1, 2, 4, 5, 6, 3)
    data_hz: int = 10_000_000
    register_hz: int = 10_000_000
    counts_per_degree: float = 512.0
    zero_deg_c: float = 23.0
    start_ms: int = 100
    pulse: int = TIME_HZ // 20_000
    little: bool = True
    dummies: int = 1

    def after_reset(self) -> Registers:
        return {}

    def known(self, register: int) -> int | None:
        return None

    def setup(self, chip: GyroChip) -> Setup:
        return Setup(None)


BMI270 = BmiKind(name="BMI270", who_am_i=0x24)
