"""weak_motor.c: motors that give less speed for their output than the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.rotor import target_speed
from neuroflight.toolchain.contract import WEAK_MOTOR_MS

RATE_HZ, MOTORS = 1000, 4


class Weak:
    """The judge of four motors."""

    def __init__(self, core: Any) -> None:
        self._core, self.struct = core, core.new("struct weak_motor *")
        core.lib.weak_motor_init(self.struct, RATE_HZ)

    def fly(self, speeds: Sequence[float], outputs: Sequence[float], ms: int, silent: int = 0) -> list[int]:
        """So many control steps; the numbers of the weak motors."""
        for _ in range(ms * RATE_HZ // 1000):
            self._core.lib.weak_motor_step(self.struct, list(speeds), silent, list(outputs))
        return [motor + 1 for motor in range(MOTORS) if self.struct.weak >> motor & 1]


@pytest.fixture
def weak(scripted: Any) -> Weak:
    return Weak(scripted)


def test_a_motor_with_less_than_half_the_others_speed_is_named(weak: Weak) -> None:
    outputs = [0.4] * MOTORS
    assert weak.fly([1400.0, 1400.0, 600.0, 1400.0], outputs, WEAK_MOTOR_MS - 100) == []
    assert weak.fly([1400.0, 1400.0, 600.0, 1400.0], outputs, 400) == [3]
    assert weak.fly([1400.0] * MOTORS, outputs, 1000) == [3], "until the next flight"


@pytest.mark.parametrize("motor", range(MOTORS))
def test_a_motor_that_stands_is_named(weak: Weak, motor: int) -> None:
    speeds = [0.0 if each == motor else 1400.0 for each in range(MOTORS)]
    assert weak.fly(speeds, [0.4] * MOTORS, 2 * WEAK_MOTOR_MS) == [motor + 1]


@pytest.mark.parametrize("name", ["nf1", "iris"])
def test_no_sound_motor_is_named_whatever_outputs_it_has(weak: Weak, name: str) -> None:
    rng, aircraft = np.random.default_rng(1), load_aircraft(name)
    speed = np.zeros(MOTORS)
    for _ in range(200):
        outputs = rng.uniform(0.05, 1.0, MOTORS)
        for _ in range(25):
            speed += 0.025 * (np.asarray(target_speed(outputs, aircraft.propulsion)) - speed)
            assert weak.fly(speed.tolist(), outputs.tolist(), 1) == []
    outputs = np.array([0.06, 1.0, 1.0, 1.0])
    steady = np.asarray(target_speed(outputs, aircraft.propulsion))
    assert weak.fly(steady.tolist(), outputs.tolist(), 3000) == []


def test_a_silent_motor_is_not_judged(weak: Weak) -> None:
    assert weak.fly([1400.0, 0.0, 1400.0, 1400.0], [0.4] * MOTORS, 3000, silent=2) == []
