"""Why it does not arm, as a pilot in the field hears and sees it: the switch is on, and nothing turns."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from typing import Any

import pytest

from neuroflight.flash.link.client import Client
from neuroflight.toolchain.contract import FaultKind, Msp
from tests.firmware.joined.field import Field

Make = Callable[..., Field]
ROUND_MS = 3500  # longer than one of a count of 2
LONG_MS = 100  # a beep of a count lasts longer, a tick of the buzz does not


@pytest.fixture
def field(scripted: Any, chip: Callable[..., Any]) -> Make:
    return lambda **kwargs: Field(scripted, chip(), **kwargs)


def counts(text: str) -> list[int]:
    """The beeps of each whole round in a text of milliseconds; a buzz of five ticks begins one."""
    found: list[int] = []
    ticks = 0
    for on, run in groupby(text):
        length = len(list(run))
        if on == "#" and length < LONG_MS:
            ticks += 1
            if ticks == 5:
                found.append(0)
        elif on == "#":
            ticks = 0
            if found:
                found[-1] += 1
    return found[:-1]  # the last may be cut off


def told(f: Field, ms: int = 3 * ROUND_MS) -> set[int]:
    """What is heard, and seen, meanwhile: only one count; and no motor moves."""
    f.run(200)
    f.run(ms)
    heard, seen = counts(f.beeps), counts(f.light)
    assert heard == seen
    assert not f.fw.status.trace.armed
    return set(heard)


def test_the_throttle_is_counted_and_then_the_switch_until_it_arms(field: Make) -> None:
    f = field()
    f.boot()
    f.throttle = 1300
    assert told(f) == set(), "nobody asks"
    f.arm = 2000
    assert told(f) == {2}
    f.throttle = 1000
    assert told(f) == {1}
    f.arm = 1000
    assert told(f) == set()
    f.arm = 2000
    f.run(100)
    assert f.fw.status.trace.armed
    f.run(2000)
    assert counts(f.beeps) == counts(f.light) == []


def test_a_switch_that_is_on_at_power_up_is_told_to_wait_and_then_to_be_cycled(field: Make) -> None:
    f = field(arming_delay_ms=10_000)
    f.arm = 2000
    f.run(1500)
    assert told(f, 7500) == {4}
    f.run(1500)
    assert told(f) == {1}


def test_the_highest_count_is_told_when_several_reasons_hold(field: Make) -> None:
    f = field()
    f.boot()
    Client(f).request(Msp.ARMING_DISABLE, b"\1\0")
    f.arm, f.throttle = 2000, 1300
    assert told(f, 4 * ROUND_MS) == {5}
    Client(f).request(Msp.ARMING_DISABLE, b"\0\0")
    assert told(f) == {2}


def test_a_refused_policy_is_counted_when_it_is_to_fly(field: Make) -> None:
    f = field()
    f.boot()
    f.take_off()
    f.fall_back()
    f.run(4000)
    f.land()
    f.arm = 2000
    assert told(f, 5 * ROUND_MS) == {6}
    f.arm = 1000
    f.run(300)
    f.pid, f.arm = 2000, 2000
    f.run(300)
    assert f.fw.status.trace.armed, "the PID may fly"


def test_a_fault_tells_its_own_number_when_the_switch_is_on(field: Make) -> None:
    asked, unasked = (field(fault=FaultKind.WATCHDOG) for _ in range(2))
    for f in (asked, unasked):
        f.boot()
    asked.arm = 2000
    for f in (asked, unasked):
        f.run(5000)
    assert (asked.beeps, asked.light) == (unasked.beeps, unasked.light)
    assert "#" in asked.beeps


def test_a_count_is_seen_and_not_heard_when_it_is_muted(field: Make) -> None:
    f = field(beep_not_arming=0, beep_disarmed=0)
    f.boot()
    f.throttle, f.arm = 1300, 2000
    f.run(200)
    f.run(3 * ROUND_MS)
    assert "#" not in f.beeps
    assert set(counts(f.light)) == {2}
