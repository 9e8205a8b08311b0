"""Turning motors for a while: ramp, hold, stop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from neuroflight.flash.link.client import Client
from neuroflight.flash.motors.session import (
    LIMIT_DEFAULT,
    REFRESH_S,
    MotorTest,
    check_fraction,
    check_limit,
    check_sum,
)
from neuroflight.toolchain.errors import LinkError

RAMP_DEFAULT_S = 0.5
SECONDS_DEFAULT = 2.0
SECONDS_MAX = 60.0  # of one spin: small motors without an airstream grow warm


@dataclass(frozen=True)
class Spin:
    """Motors, fraction and duration, checked on construction. Raises LinkError."""

    motors: Collection[int]  # by index
    motor_count: int
    fraction: float  # motor fraction at the end of the ramp
    seconds: float = SECONDS_DEFAULT  # from the first value to the stop, the ramp included
    ramp_s: float = RAMP_DEFAULT_S
    limit: float = LIMIT_DEFAULT  # maximum of `fraction`

    def __post_init__(self) -> None:
        check_limit(self.limit)
        check_fraction("--fraction", self.fraction, self.limit)
        if not self.motors or not all(0 <= motor < self.motor_count for motor in self.motors):
            told = ", ".join(str(motor + 1) for motor in self.motors) or "none"
            raise LinkError(f"motor got {told}, expected 1 to {self.motor_count}, or all")
        if not (math.isfinite(self.seconds) and 0.0 < self.seconds <= SECONDS_MAX):
            raise LinkError(f"--seconds got {self.seconds:g}, expected above 0 and at most {SECONDS_MAX:g}")
        if not (math.isfinite(self.ramp_s) and 0.0 <= self.ramp_s <= SECONDS_MAX):
            raise LinkError(f"--ramp got {self.ramp_s:g}, expected 0 to {SECONDS_MAX:g} seconds")
        check_sum(self.at(math.inf))

    def at(self, elapsed_s: float) -> list[float]:
        """Return the motor fractions, motor order, at that time since the start."""
        share = 1.0 if elapsed_s >= self.ramp_s else elapsed_s / self.ramp_s
        value = self.fraction * share
        return [value if motor in self.motors else 0.0 for motor in range(self.motor_count)]


def spin(
    client: Client,
    wanted: Spin,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Open a test, turn the motors, stop them, close the test. Raises LinkError with them stopped."""
    with MotorTest(client, wanted.motor_count, wanted.limit) as test:
        begin = clock()
        while (elapsed := clock() - begin) < wanted.seconds:
            test.turn(wanted.at(elapsed))
            sleep(min(REFRESH_S, max(0.0, wanted.seconds - (clock() - begin))))
