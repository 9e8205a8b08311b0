"""Full stick at the highest rate that may be set: faster than the gyro can tell, and back again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.flight.scenario import Rates, Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.contract import (
    GYRO_BAD_MS,
    GYRO_FULL_SCALE_DEG_S,
    GYRO_SATURATED_MS,
    RATE_MAX_DEG_S,
)

THROTTLE = 0.5
MOST = {f"{axis}_max": RATE_MAX_DEG_S for axis in ("roll", "pitch", "yaw")}


def longest(held: np.ndarray) -> int:
    """Most steps in a row that hold."""
    return max(map(len, "".join("x" if one else " " for one in held).split()), default=0)


def full_stick(axis: int) -> Scenario:
    """To the right or forward, back at once the other way, then still."""
    right: list[float] = [0.0, 0.0, 0.0]
    right[axis] = 1000.0  # of the stick: its end
    sticks: list[Rates] = [(0, 0, 0), (right[0], right[1], 0), (-right[0], -right[1], 0), (0, 0, 0)]
    return Scenario("full stick", tuple(Segment(0.6, rates, THROTTLE) for rates in sticks)).under_pid()


@pytest.mark.parametrize("axis", [0, 1])
def test_it_stays_armed_and_returns_when_it_turns_faster_than_its_gyro_can_tell(
    reference_library: Path, flown: Callable[..., Trace], axis: int
) -> None:
    trace = flown(ReferencePort(reference_library, 4000, MOST), full_stick(axis))
    true, told = (np.degrees(np.abs(rates[:, axis])) for rates in (trace.rate, trace.gyro))
    lost = longest(true > GYRO_FULL_SCALE_DEG_S)
    assert 1.2 * GYRO_BAD_MS < lost < GYRO_SATURATED_MS, "the flight shows what it is to show"
    assert told.max() <= GYRO_FULL_SCALE_DEG_S + 20  # with the bias taken out
    assert (trace.dshot > 0).all()
    assert true[-100:].max() < 30


@pytest.mark.slow
def test_a_saturated_gyro_is_flown_with_the_same_bits_on_library_host_and_board(
    reference_library: Path, host_program: Path, board_image: Path, flown: Callable[..., Trace]
) -> None:
    turn = Scenario("turn", full_stick(0).segments[1:3]).under_pid()
    expected = flown(ReferencePort(reference_library, 4000, MOST), turn)
    assert np.degrees(np.abs(expected.gyro)).max() > 1980
    for port in (
        HostPort(host_program, 4000, MOST),
        EmulatedPort(board_image.with_suffix(".bin"), settings=MOST),
    ):
        assert expected.same(flown(port, turn))
