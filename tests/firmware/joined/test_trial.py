"""A trial of a policy: it flies only while its switch is held."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    CHANNEL_PID,
    CHANNEL_TRIAL,
    RECEIVER_HOLD_MS,
    SWITCH_ON_US,
    FallbackCause,
    FlightState,
)

Make = Callable[..., Any]


@pytest.fixture
def trial(bench: Make, scripted: Any) -> Make:
    """Makes benches with a PID, armed, on trial unless told otherwise."""

    def make(**settings: float) -> Any:
        pid = scripted.new("struct pid_gains *")
        pid.motor_count, pid.period_s, pid.smoothing = 4, 1e-3, 1.0
        b = bench(1000, pid=pid, **{"policy_trial": 1, **settings})
        b.arm()
        b.run(50, **held(SWITCH_ON_US - 1))
        return b

    return make


def held(trial_us: int, pid_us: int = 1000) -> dict[str, int]:
    return {"arm": 2000, f"c{CHANNEL_TRIAL}": trial_us, f"c{CHANNEL_PID}": pid_us}


def test_the_policy_flies_only_while_the_switch_is_held_when_it_is_on_trial(trial: Make) -> None:
    b = trial()
    assert b.status.pid_flies
    for _ in range(3):
        b.run(50, **held(SWITCH_ON_US))
        assert not b.status.pid_flies
        b.run(50, **held(SWITCH_ON_US - 1))
        assert (b.status.pid_flies, b.status.fallback_cause) == (True, FallbackCause.SWITCH)
    assert b.armed


def test_the_pid_flies_when_its_own_switch_asks_for_it_in_a_trial(trial: Make) -> None:
    b = trial()
    b.run(50, **held(SWITCH_ON_US, SWITCH_ON_US))
    assert b.status.pid_flies
    b.run(50, **held(SWITCH_ON_US, SWITCH_ON_US - 1))
    assert not b.status.pid_flies


def test_the_pid_takes_over_when_the_receiver_is_not_heard_in_a_trial(trial: Make) -> None:
    b = trial()
    b.run(50, **held(SWITCH_ON_US))
    b.run(RECEIVER_HOLD_MS - 15, every_ms=None)
    assert not b.status.pid_flies
    b.run(20, every_ms=None)
    assert (b.status.state, b.status.pid_flies) == (FlightState.FAILSAFE_HOLD, True)
    b.run(30, **held(SWITCH_ON_US))
    assert not b.status.pid_flies, "the pilot still holds it"


def test_the_switch_of_a_trial_does_nothing_when_none_is_set(trial: Make) -> None:
    b = trial(policy_trial=0)
    assert not b.status.pid_flies
    b.run(RECEIVER_HOLD_MS + 20, every_ms=None)
    assert (b.status.state, b.status.pid_flies) == (FlightState.FAILSAFE_HOLD, False)
