"""arming.c: the transition table, exhaustively."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest

from toolchain.contract import ArmingReason

OWN = 1 << ArmingReason.SWITCH_NOT_CYCLED
OTHERS = [reason for reason in ArmingReason if reason is not ArmingReason.SWITCH_NOT_CYCLED]
LOST = 1 << ArmingReason.RECEIVER_LOST
STOPPING = LOST | 1 << ArmingReason.POLICY_BAD


class Case:
    """One call from one state under one set of reasons."""

    def __init__(self, core: Any, state: int, reasons: int, switch_on: bool) -> None:
        arming = core.new("struct arming *", (state,))
        self.before, self.reasons, self.switch_on = state, reasons, switch_on
        self.told = core.lib.arming_step(arming, reasons, switch_on)
        self.after = arming.state
        self.shown = core.lib.arming_reasons(arming, reasons)


@pytest.fixture
def cases(puppet: Any) -> Iterator[Case]:
    """All of them: each state, each combination of reasons, switch on and off."""
    reasons = [
        sum(1 << reason for reason, on in zip(OTHERS, bits, strict=True) if on)
        for bits in product((False, True), repeat=len(OTHERS))
    ]
    states = range(puppet.lib.ARMING_STATE_COUNT)
    return (Case(puppet, *case) for case in product(states, reasons, (False, True)))


def test_motors_start_only_when_ready_and_switched_on_and_nothing_forbids_it(
    puppet: Any,
    cases: Iterator[Case],
) -> None:
    for case in cases:
        started = case.before != puppet.lib.ARMING_ARMED and case.after == puppet.lib.ARMING_ARMED
        allowed = case.before == puppet.lib.ARMING_READY and case.switch_on and case.reasons == 0
        assert started == allowed
        assert case.told == started


def test_motors_go_on_only_when_switched_on_with_receiver_and_good_policy(
    puppet: Any,
    cases: Iterator[Case],
) -> None:
    for case in cases:
        if case.before == puppet.lib.ARMING_ARMED:
            goes_on = case.switch_on and not case.reasons & STOPPING
            assert (case.after == puppet.lib.ARMING_ARMED) == goes_on


def test_readiness_is_gained_only_when_a_living_receiver_shows_the_switch_off(
    puppet: Any,
    cases: Iterator[Case],
) -> None:
    for case in cases:
        if case.after == puppet.lib.ARMING_READY and case.before != puppet.lib.ARMING_READY:
            assert not case.switch_on
            assert not case.reasons & LOST


def test_readiness_is_lost_when_the_receiver_is_or_the_switch_comes_too_early(
    puppet: Any,
    cases: Iterator[Case],
) -> None:
    for case in cases:
        if case.before == puppet.lib.ARMING_READY:
            spoiled = bool(case.reasons & LOST) or (case.switch_on and case.reasons != 0)
            assert (case.after == puppet.lib.ARMING_LOCKED) == spoiled


def test_reasons_are_shown_when_and_only_when_the_switch_would_not_arm(
    puppet: Any,
    cases: Iterator[Case],
) -> None:
    for case in cases:
        if case.after == puppet.lib.ARMING_ARMED:
            assert case.shown == 0
        else:
            assert case.shown & ~OWN == case.reasons
            assert bool(case.shown & OWN) == (case.after == puppet.lib.ARMING_LOCKED)


def test_it_starts_locked_when_initialised(puppet: Any) -> None:
    arming = puppet.new("struct arming *", (puppet.lib.ARMING_ARMED,))
    puppet.lib.arming_init(arming)
    assert arming.state == puppet.lib.ARMING_LOCKED
    assert not puppet.lib.arming_is_armed(arming)
