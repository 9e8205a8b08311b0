"""A flight again on each machine: equal to the bit, and what was changed is found at its step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.replay.comparison import compare
from neuroflight.sim.replay.emulator import replay_on_board
from neuroflight.sim.replay.host import replay_on_host
from neuroflight.sim.replay.inputs import Answers, Flight
from neuroflight.sim.replay.library import replay_on_library
from neuroflight.toolchain.contract import DSHOT_STOP, LogEdge
from neuroflight.toolchain.errors import LinkError, TraceError
from tests.sim.replay.recorder import recorded

Replay = Callable[[Flight], Answers]


@pytest.fixture
def on_library(reference_library: Path) -> Replay:
    return lambda flight: replay_on_library(reference_library, flight)


@pytest.fixture
def on_host(host_program: Path) -> Replay:
    return lambda flight: replay_on_host(host_program, flight)


@pytest.fixture
def on_board(board_image: Path) -> Replay:
    return lambda flight: replay_on_board(board_image.with_suffix(".bin"), flight)


def turning(flight: Flight) -> int:
    """Control steps with motors that turn."""
    return int((flight.answers.dshot != DSHOT_STOP).any(axis=1).sum())


def test_the_troubled_flight_has_a_fallback_and_a_fault(calm_flight: Flight, troubled_flight: Flight) -> None:
    inputs = troubled_flight.inputs
    assert turning(calm_flight) > 1400
    assert 200 < turning(troubled_flight) < turning(calm_flight) - 100
    assert (inputs.flags & LogEdge.MISSED).any() and inputs.invalid.any() and inputs.silences.any()


@pytest.mark.parametrize("machine", ["on_library", "on_host"])
@pytest.mark.parametrize("flown", ["calm_flight", "troubled_flight"])
def test_every_value_is_equal_when_a_flight_is_replayed(
    flown: str, machine: str, request: pytest.FixtureRequest
) -> None:
    flight, replay = request.getfixturevalue(flown), request.getfixturevalue(machine)
    found = compare(flight, replay(flight))
    assert found.equal, str(found)
    assert found.values == 4 * len(flight) and found.exact == ("gyro", "setpoint", "throttle")


def test_every_value_is_equal_when_the_image_replays_a_flight(
    troubled_flight: Flight, on_board: Replay
) -> None:
    part = first_steps(troubled_flight, 650)
    found = compare(part, on_board(part))
    assert found.equal, str(found)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [1000, 2000, 8000])
@pytest.mark.parametrize("machine", ["on_library", "on_host", "on_board"])
def test_every_value_is_equal_at_each_gyro_rate(
    rate_hz: int, machine: str, reference_library: Path, request: pytest.FixtureRequest
) -> None:
    flight = recorded(reference_library, load_scenario("pulses", 1, 2), rate_hz=rate_hz)
    replay = request.getfixturevalue(machine)
    found = compare(flight, replay(flight))
    assert found.equal and turning(flight) > 2000, str(found)


def first_steps(flight: Flight, count: int) -> Flight:
    """`flight` up to a control step."""
    inputs = {name: getattr(flight.inputs, name)[:count] for name in flight.inputs.__dataclass_fields__}
    answers = {name: getattr(flight.answers, name)[:count] for name in flight.answers.__dataclass_fields__}
    return replace(
        flight, inputs=type(flight.inputs)(**inputs), answers=Answers(**answers), t=flight.t[:count]
    )


def flipped(flight: Flight, name: str, place: tuple[int, ...], bit: int) -> Flight:
    """`flight` with a bit of one of its inputs turned over."""
    values: Any = getattr(flight.inputs, name).copy()
    kind = f"i{values.itemsize}"
    view = values.view(kind)
    view[place] ^= np.array(1, kind) << np.array(bit, kind)
    return replace(flight, inputs=replace(flight.inputs, **{name: values}))


@pytest.mark.parametrize("machine", ["on_library", "on_host"])
@pytest.mark.parametrize("seed", range(5))
def test_a_flipped_bit_of_a_gyro_sample_is_found_at_its_step(
    seed: int, machine: str, calm_flight: Flight, request: pytest.FixtureRequest
) -> None:
    rng = np.random.default_rng(seed)
    step, axis = int(rng.integers(200, 1600)), int(rng.integers(3))
    last = 3  # the control step's; without filters nothing looks at the three before it
    changed = flipped(calm_flight, "counts", (step, last, axis), int(rng.integers(8)))
    found = compare(changed, request.getfixturevalue(machine)(changed))
    assert found.first is not None and found.first.step == step
    assert "gyro" in found.first.exact


def test_a_flipped_bit_of_a_stick_is_found_at_its_step(calm_flight: Flight, on_library: Replay) -> None:
    steps = np.flatnonzero((calm_flight.inputs.received == 25) & (calm_flight.t > 0.4))
    changed = flipped(calm_flight, "receiver", (int(steps[0]), 1), 5)  # of roll's 11 bits
    found = compare(changed, on_library(changed))
    assert found.first is not None and found.first.step == steps[0] and "setpoint" in found.first.exact


def test_a_deadline_that_was_not_missed_is_found_as_soon_as_the_pid_would_not_have_flown(
    troubled_flight: Flight, on_library: Replay
) -> None:
    late = np.flatnonzero(troubled_flight.inputs.flags & LogEdge.MISSED)
    changed = flipped(troubled_flight, "flags", (int(late[-1]),), 5)
    found = compare(changed, on_library(changed))
    assert found.first is not None and found.first.step == late[-1] + 1
    assert found.first.logged != found.first.replayed


def test_a_changed_motor_value_of_the_log_is_found_at_its_step(
    calm_flight: Flight, on_library: Replay
) -> None:
    dshot = calm_flight.answers.dshot.copy()
    dshot[700, 2] ^= 1
    changed = replace(calm_flight, answers=replace(calm_flight.answers, dshot=dshot))
    found = compare(changed, on_library(changed))
    assert found.first is not None and (found.first.step, found.different) == (700, 1)
    assert f"motors logged {' '.join(map(str, dshot[700]))}, replayed" in str(found)


def test_a_state_of_another_layout_is_refused_in_a_line(
    calm_flight: Flight, on_library: Replay, on_host: Replay, on_board: Replay
) -> None:
    for changed in (
        replace(calm_flight, layout=calm_flight.layout ^ 1),
        replace(calm_flight, state=calm_flight.state[:-8]),
    ):
        with pytest.raises(TraceError, match="another source or policy flew"):
            on_library(changed)
        with pytest.raises(LinkError, match="of the state: got"):
            on_host(changed)
    with pytest.raises(TraceError, match="another source or policy flew"):
        on_board(replace(calm_flight, state=calm_flight.state[:-8]))


@pytest.mark.slow
def test_a_state_that_crashes_the_firmware_is_told_in_a_line(calm_flight: Flight, on_library: Replay) -> None:
    wild = b"\x80" * len(calm_flight.state)  # counts and places beyond all bounds
    with pytest.raises(TraceError, match=r"the firmware crashed on it|does not follow"):
        on_library(replace(calm_flight, state=wild))


def test_a_step_that_does_not_follow_is_refused_with_its_number(
    calm_flight: Flight, on_library: Replay
) -> None:
    samples = calm_flight.inputs.samples.copy()
    samples[300] = 3
    changed = replace(calm_flight, inputs=replace(calm_flight.inputs, samples=samples))
    with pytest.raises(TraceError, match="control step 300 does not follow"):
        on_library(changed)
