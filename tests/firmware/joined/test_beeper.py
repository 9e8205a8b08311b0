"""The beeper of a board in the field: the pilot's call, and conditions that are muted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.toolchain.contract import CHANNEL_AUX1, CHANNEL_BEEPER, SETTINGS, FaultKind, Mode, ModeRange
from tests.firmware.joined.field import Field

MUTED = {setting.name: 0 for setting in SETTINGS if setting.name.startswith("beep_")}
Make = Callable[..., Field]


@pytest.fixture
def field(scripted: Any, chip: Callable[..., Any]) -> Make:
    return lambda **kwargs: Field(scripted, chip(), **kwargs)


@pytest.mark.parametrize("muted", [{}, MUTED], ids=["all on", "all muted"])
def test_the_beeper_sounds_while_its_mode_is_on(field: Make, muted: dict[str, int]) -> None:
    f = field(**muted)
    f.boot()
    f.run(1000)
    assert "#" not in f.beeps
    f.sticks = {CHANNEL_BEEPER: 1700}
    f.run(2000)
    assert f.beeps.count("#") > 500
    f.heard = False
    f.run(900)
    assert f.beeps.count("#") > 200, "the switch is held with the link"
    f.heard, f.sticks = True, {CHANNEL_BEEPER: 1699}
    f.run(1000)
    f.run(1000)
    assert "#" not in f.beeps


def test_the_beeper_sounds_by_another_channel_when_its_range_is_there(field: Make) -> None:
    f = field(mode3=ModeRange(Mode.BEEPER, 9, 900, 1300).packed)
    f.sticks = {CHANNEL_AUX1 + 8: 1500}
    f.boot()
    f.sticks = {CHANNEL_AUX1 + 8: 1500, CHANNEL_BEEPER: 2000}
    f.run(1000)
    assert "#" not in f.beeps
    f.sticks = {CHANNEL_AUX1 + 8: 1000}
    f.run(1000)
    assert "#" in f.beeps


def test_a_lost_receiver_is_no_call_when_the_range_lies_low(field: Make) -> None:
    f = field(mode3=ModeRange(Mode.BEEPER, 9, 900, 1300).packed, **MUTED)
    f.sticks = {CHANNEL_AUX1 + 8: 1500}
    f.boot()
    f.heard = False
    f.run(3000)
    assert "#" not in f.beeps


def test_a_fault_is_seen_and_not_heard_when_it_is_muted(field: Make) -> None:
    loud, muted = (
        field(fault=FaultKind.WATCHDOG),
        field(fault=FaultKind.WATCHDOG, beep_fault=0, beep_disarmed=0),
    )
    for f in (loud, muted):
        f.boot()
        f.run(5000)
    assert "#" in loud.beeps and "#" not in muted.beeps
    assert muted.light == loud.light and "#" in muted.light


def test_the_lost_receiver_is_heard_or_not_as_it_is_set(field: Make) -> None:
    heard = {}
    for on in (0, 1):
        f = field(beep_receiver_lost=on, beep_disarmed=0)
        f.boot()
        f.heard = False
        f.run(2000)
        heard[on] = "#" in f.beeps
    assert heard == {0: False, 1: True}
