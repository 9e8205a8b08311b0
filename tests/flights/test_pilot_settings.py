"""Settings of how the aircraft is built and wired: set as it is, it flies as the one of its file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from sim.flight.scenario import Scenario, Segment
from sim.flight.trace import Trace
from sim.ports.library import ReferencePort

GYRO_RATE_HZ = 4000
Flown = Callable[..., Trace]
TURNS = Scenario(
    "turns",
    (
        Segment(0.3, (100.0, 0.0, 0.0), 0.3),
        Segment(0.3, (0.0, -80.0, 60.0), 0.5),
        Segment(0.3, (-50.0, 40.0, -90.0), 0.4, pid=True),
    ),
)


def motor_order(outputs: Sequence[int]) -> dict[str, float]:
    """The settings of an aircraft whose motor i is wired to output outputs[i], both from 1."""
    return {f"motor{motor}_output": output for motor, output in enumerate(outputs, start=1)}


@pytest.mark.parametrize("outputs", [(2, 1, 3, 4), (4, 2, 1, 3), (2, 3, 4, 1)])
def test_an_aircraft_flies_the_same_bits_when_its_motors_are_wired_as_set(
    reference_library: Path, flown: Flown, outputs: tuple[int, ...]
) -> None:
    straight = flown(ReferencePort(reference_library, GYRO_RATE_HZ), TURNS)
    port = ReferencePort(reference_library, GYRO_RATE_HZ, motor_order(outputs))
    motor_of = tuple(np.argsort(outputs).tolist())
    crossed = flown(port, TURNS, motor_order=motor_of)
    np.testing.assert_array_equal(crossed.dshot, straight.dshot[:, motor_of])
    np.testing.assert_array_equal(crossed.rate, straight.rate)
    np.testing.assert_array_equal(crossed.gyro, straight.gyro)
