"""The comparison of what was asked for with what the firmware flies."""

from __future__ import annotations

from dataclasses import replace

from neuroflight.flash.mavlink.setpoint_check import SAMPLES, SetpointCheck
from neuroflight.flash.monitoring.stream import Sample
from neuroflight.toolchain.contract import FlightState

PERIOD_S = 0.02
FLOWN = Sample(
    *(0, 0, 0, FlightState.ARMED.name),
    armed=True,
    pid_flies=False,
    setpoint=(1.0, 0.0, 0.0),
    gyro=(0.0, 0.0, 0.0),
    throttle=0.0,
    dshot=(),
    observation=(),
    action=(),
)
OTHER = replace(FLOWN, setpoint=(1.1, 0.0, 0.0))


def asked(check: SetpointCheck, first: int, last: int, roll: float = 1.0) -> float:
    """Channels of those frames, 20 ms each; returns when the last one went out."""
    for frame in range(first, last):
        check.sent((roll, 0.0, 0.0), frame * PERIOD_S)
    return (last - 1) * PERIOD_S


def test_nothing_is_wrong_when_it_flies_what_was_asked() -> None:
    check = SetpointCheck()
    for last in range(30, 60):
        assert not check.see(FLOWN, asked(check, last - 1, last))
    assert not check.wrong


def test_it_is_wrong_after_some_samples_in_a_row_and_told_once() -> None:
    check = SetpointCheck()
    now = asked(check, 0, 30)
    seen = [check.see(OTHER, now) for _ in range(SAMPLES + 2)]
    assert seen == [False] * (SAMPLES - 1) + [True, False, False]
    assert check.wrong


def test_a_good_sample_between_begins_anew() -> None:
    check = SetpointCheck()
    now = asked(check, 0, 30)
    for _ in range(5):
        for _ in range(SAMPLES - 1):
            assert not check.see(OTHER, now)
        assert not check.see(FLOWN, now)


def test_a_sample_from_before_a_change_is_good_and_later_no_more() -> None:
    check = SetpointCheck()
    asked(check, 0, 30)
    now = asked(check, 30, 35, roll=2.0)
    assert not any(check.see(FLOWN, now) for _ in range(5))
    now = asked(check, 35, 60, roll=2.0)
    assert any(check.see(FLOWN, now) for _ in range(5))


def test_nothing_is_said_soon_after_a_pause_or_in_states_that_obey_no_stick() -> None:
    check = SetpointCheck()
    now = asked(check, 0, 10)
    assert not any(check.see(OTHER, now) for _ in range(5)), "the window is not full yet"
    now = asked(check, 10, 30)
    assert not any(check.see(OTHER, now + 0.2) for _ in range(5)), "no channels go out any more"
    held = replace(OTHER, state=FlightState.FAILSAFE_HOLD.name)
    assert not any(check.see(held, now) for _ in range(5))
    now = asked(check, 60, 65)
    assert not any(check.see(OTHER, now) for _ in range(5)), "they began anew"
