"""The mode CHIRP in the joined core: when a sine is added to the setpoint, and when not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    CHANNEL_AUX1,
    CHANNEL_PID,
    RECEIVER_HOLD_MS,
    FallbackCause,
    FlightState,
    Mode,
    ModeRange,
    StopCause,
)

Make = Callable[..., Any]
AUX = 5
CHIRP = f"c{CHANNEL_AUX1 + AUX - 1}"
SETTINGS = {"mode5": ModeRange(Mode.CHIRP, AUX, 1700, 2100).packed, "chirp_start_hz": 5.0}
ON, OFF = 2000, 1000
OFF_MS = 30  # in which frames tell a switch


@pytest.fixture
def make_chirping(bench: Make, scripted: Any) -> Make:
    """Makes benches with a PID, armed, the mode off unless told otherwise."""

    def make(mode: int = OFF, **settings: float) -> Any:
        pid = scripted.new("struct pid_gains *")
        pid.motor_count, pid.period_s, pid.smoothing = 4, 1e-3, 1.0
        b = bench(1000, pid=pid, **{**SETTINGS, **settings})
        b.run(1001, **{CHIRP: mode})
        b.run(OFF_MS, arm=2000, **{CHIRP: mode})
        assert b.armed
        return b

    return make


@pytest.fixture
def chirping(make_chirping: Make) -> Any:
    return make_chirping()


def setpoints(b: Any, ms: int, mode: int, **sticks: int) -> list[list[float]]:
    """The setpoint of each control step."""
    seen = []
    for _ in range(ms):
        b.run(1, **{"arm": 2000, "throttle": 1300, CHIRP: mode, **sticks})
        seen.append(list(b.trace.setpoint))
    return seen


def excited(seen: list[list[float]]) -> list[bool]:
    """Whether each axis was."""
    return [any(step[axis] != 0.0 for step in seen) for axis in range(3)]


def axis(b: Any) -> int:
    return int(b.core.lib.chirp_axis(b.core.ffi.addressof(b.fw.chirp)))


def test_the_mode_excites_one_axis_after_the_other(chirping: Any) -> None:
    for expected in (0, 1, 2, 0):
        assert excited(setpoints(chirping, 100, ON)) == [each == expected for each in range(3)]
        assert axis(chirping) == expected
        setpoints(chirping, OFF_MS, OFF)
        assert excited(setpoints(chirping, 100, OFF)) == [False] * 3
        assert axis(chirping) == -1
    assert chirping.armed


def test_the_sine_is_added_to_what_the_stick_asks_for(make_chirping: Make) -> None:
    plain, b = (make_chirping(plausibility_detection=0) for _ in range(2))
    still = setpoints(plain, 400, OFF, c0=1600)
    seen = setpoints(b, 400, ON, c0=1600)
    assert [step[1:] for step in seen] == [step[1:] for step in still]
    added = [step[0] - other[0] for step, other in zip(seen, still, strict=True)]
    assert max(added) > 0.5
    assert min(added) < -0.2


def test_nothing_is_added_when_the_motors_were_armed_with_the_mode_on(make_chirping: Make) -> None:
    b = make_chirping(mode=ON)
    assert excited(setpoints(b, 200, ON)) == [False] * 3
    setpoints(b, OFF_MS, OFF)
    assert excited(setpoints(b, 100, ON)) == [True, False, False]


def test_nothing_is_added_while_disarmed(chirping: Any) -> None:
    for mode in (OFF, ON, OFF, ON):
        assert excited(setpoints(chirping, 100, mode, arm=1000, throttle=1000)[OFF_MS:]) == [False] * 3
    assert axis(chirping) == -1


def test_it_ends_when_the_pilot_disarms_and_does_not_come_back_by_arming(chirping: Any) -> None:
    setpoints(chirping, 100, ON)
    setpoints(chirping, OFF_MS, ON, arm=1000, throttle=1000)
    assert chirping.status.state == FlightState.DISARMED
    assert axis(chirping) == -1
    assert excited(setpoints(chirping, 200, ON, throttle=1000)) == [False] * 3
    assert chirping.armed


def test_it_ends_when_the_receiver_is_not_heard_and_does_not_come_back_with_it(chirping: Any) -> None:
    setpoints(chirping, 100, ON)
    chirping.run(RECEIVER_HOLD_MS + 10, every_ms=None)
    assert chirping.status.state == FlightState.FAILSAFE_HOLD
    assert axis(chirping) == -1
    assert list(chirping.trace.setpoint) == [0.0] * 3
    assert excited(setpoints(chirping, 100, ON)) == [False] * 3
    assert chirping.status.state == FlightState.ARMED
    setpoints(chirping, OFF_MS, OFF)
    assert excited(setpoints(chirping, 100, ON)) == [False, True, False]


@pytest.mark.parametrize("stage", [0, 1], ids=["drop", "descend"])
def test_nothing_is_added_in_failsafe(make_chirping: Make, stage: int) -> None:
    b = make_chirping(failsafe_stage=stage)
    setpoints(b, 100, ON)
    for _ in range(1000):
        b.run(1, every_ms=None)
        assert axis(b) == -1 or b.status.state == FlightState.ARMED
    assert b.status.state == FlightState.FAILSAFE_DROP
    assert b.armed == bool(stage), "one stage flies on"
    assert list(b.trace.setpoint) == [0.0] * 3


def test_it_ends_when_the_other_controller_flies(chirping: Any) -> None:
    setpoints(chirping, 100, ON)
    setpoints(chirping, OFF_MS, ON, **{f"c{CHANNEL_PID}": ON})
    assert (chirping.status.pid_flies, chirping.status.fallback_cause) == (True, FallbackCause.SWITCH)
    assert axis(chirping) == -1
    assert excited(setpoints(chirping, 100, ON, **{f"c{CHANNEL_PID}": ON})) == [False] * 3


def test_a_crash_is_found_and_ends_it(make_chirping: Make, scripted: Any) -> None:
    b = make_chirping(plausibility_detection=0)
    setpoints(b, 100, ON)
    scripted.lib.scripted_action = [0.0, 0.0, 0.6, 0.6]
    b.counts = (int(700 * 32768 / 2000), 0, 0)  # rolls by 700 deg/s, whatever the motors do
    setpoints(b, 600, ON)
    assert b.status.state == FlightState.CRASHED
    assert b.status.stop_cause in (StopCause.CRASH, StopCause.RUNAWAY)
    assert axis(b) == -1
    assert excited(setpoints(b, 200, ON)) == [False] * 3


def test_the_mode_is_told_as_the_others_are(chirping: Any) -> None:
    setpoints(chirping, 100, ON)
    assert chirping.status.modes & 1 << chirping.core.lib.MODE_CHIRP
    setpoints(chirping, OFF_MS, OFF)
    assert not chirping.status.modes & 1 << chirping.core.lib.MODE_CHIRP
