"""The interlocks of offboard, by themselves."""

from __future__ import annotations

import pytest

from neuroflight.flash.mavlink.offboard import IDLE, OFF_S, SOURCES_MAX, Offboard, Setpoint, Source
from neuroflight.toolchain.contract import CHANNEL_THROTTLE

ONE: Source = (0, 201, 191)
OTHER: Source = (0, 202, 191)
LOW, HIGH = Setpoint(dict(IDLE)), Setpoint({**IDLE, CHANNEL_THROTTLE: 1400})


def offboard(**changed: bool) -> Offboard:
    return Offboard(**{"allowed": True, "may_arm": True, **changed})


def steered(setpoint: Setpoint = LOW) -> Offboard:
    """ONE steers from 0 s on."""
    made = offboard()
    made.hear(ONE, setpoint, 0.0)
    assert made.enable(ONE, 0.0, armed=False) == ""
    return made


def test_nothing_is_told_when_nobody_enabled_it() -> None:
    made = offboard()
    made.hear(ONE, HIGH, 0.0)
    assert made.told(0.0) is None
    assert made.arm(ONE, 0.0)


@pytest.mark.parametrize("allowed", [False])
def test_nobody_steers_without_permission(allowed: bool) -> None:
    made = offboard(allowed=allowed)
    made.hear(ONE, LOW, 0.0)
    assert "--offboard" in made.enable(ONE, 0.0, armed=False)
    assert made.told(0.0) is None and made.owner is None
    assert "transmitter" in made.disarm(0.0)
    assert made.told(0.0) is None


def test_setpoints_come_before_enabling() -> None:
    made = offboard()
    assert "setpoints first" in made.enable(ONE, 0.0, armed=False)
    made.hear(ONE, LOW, 0.0)
    assert "setpoints first" in made.enable(ONE, 0.3, armed=False)
    assert "setpoints first" in made.enable(OTHER, 0.0, armed=False)
    assert made.owner is None


def test_only_who_enabled_it_is_obeyed() -> None:
    made = steered()
    made.hear(OTHER, HIGH, 0.0)
    assert "201" in made.enable(OTHER, 0.0, armed=False)
    told = made.told(0.1)
    assert told is not None and told.channels_us == LOW.channels_us
    assert "enable" in made.arm(OTHER, 0.0)
    assert not made.armed


def test_silence_ends_it_for_good_at_the_time_out() -> None:
    made = steered()
    assert not made.expire(0.299) and made.told(0.299) is not None
    assert made.told(0.3) is None
    assert made.expire(0.3)
    assert not made.expire(0.4)
    made.hear(ONE, LOW, 0.5)
    assert made.told(0.5) is None, "setpoints alone do not resume"
    assert made.enable(ONE, 0.5, armed=False) == ""
    assert made.told(0.5) is not None


def test_arming_needs_permission_steering_a_fresh_setpoint_and_no_thrust() -> None:
    assert "--allow-arm" in offboard(may_arm=False).arm(ONE, 0.0)
    high = steered(HIGH)
    assert "no thrust" in high.arm(ONE, 0.0) and not high.armed
    late = steered()
    assert late.arm(ONE, 0.3) and not late.armed
    good = steered()
    assert good.arm(ONE, 0.1) == ""
    told = good.told(0.1)
    assert told is not None and told.armed


def test_the_switch_is_off_again_after_the_time_out_and_stays_on_only_for_what_flies() -> None:
    made = steered()
    made.arm(ONE, 0.0)
    made.expire(0.3)
    assert not made.armed
    made.hear(ONE, HIGH, 0.4)
    made.enable(ONE, 0.4, armed=False)
    assert not made.armed
    made.release()
    made.enable(ONE, 0.4, armed=True)
    assert made.armed, "an aircraft that flies is taken over armed"


def test_enabling_again_does_not_change_the_switch() -> None:
    made = steered()
    assert made.enable(ONE, 0.1, armed=True) == ""
    assert not made.armed
    made.arm(ONE, 0.1)
    assert made.enable(ONE, 0.1, armed=False) == ""
    assert made.armed


def test_anybody_may_disarm_who_steers_or_not() -> None:
    made = steered()
    made.arm(ONE, 0.0)
    assert made.disarm(0.1) == ""
    told = made.told(0.1)
    assert told is not None and not told.armed
    alone = offboard()
    assert alone.disarm(5.0) == ""
    told = alone.told(5.0)
    assert told is not None and told.channels_us == IDLE and not told.armed
    assert alone.told(5.0 + OFF_S) is None


def test_many_strangers_do_not_push_out_who_steers() -> None:
    made = steered()
    for system in range(1, 3 * SOURCES_MAX):
        made.hear((1, system, 1), HIGH, 0.1)
    told = made.told(0.1)
    assert told is not None and told.channels_us == LOW.channels_us
    assert "setpoints first" in Offboard(allowed=True, may_arm=True).enable((1, 1, 1), 0.1, armed=False)
