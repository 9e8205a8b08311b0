"""ESCs are asked for extended telemetry while their motors stand, and what they tell is told."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from typing import Any

import pytest

from neuroflight.flash.link.messages import motor_telemetry
from neuroflight.toolchain.contract import ESC_SILENT, ESC_STANDS, DshotCommand, EscTold, Msp
from tests.firmware.joined.field import Field

BEGINS = 0xE00  # state 0, the first word after the command
TEMPERATURE, VOLTAGE = 0x22D, 0x440  # 45 degC, 16 V


class Wired(Field):
    """Its ESCs answer; what they hear is kept."""

    answer = ESC_SILENT
    sent: list[tuple[int, ...]]

    def sample(self) -> None:
        self.board.rotors[0:4] = [self.answer] * 4
        super().sample()
        self.sent.append(tuple(self.board.dshot)[:4])

    def run(self, ms: int) -> None:
        self.sent = []
        super().run(ms)

    @property
    def asked(self) -> list[int]:
        """How often in a row, each time that the command was sent to all four."""
        assert {value for frame in self.sent for value in frame} <= {0, DshotCommand.EXTENDED_TELEMETRY}
        return [len(list(run)) for frame, run in groupby(self.sent) if frame == (13,) * 4]


Make = Callable[..., Wired]


@pytest.fixture
def wired(scripted: Any, chip: Callable[..., Any]) -> Make:
    return lambda **settings: Wired(scripted, chip(), motor_telemetry=1, **settings)


def test_escs_that_answer_are_asked_for_more_until_they_tell_it(wired: Make) -> None:
    w = wired()
    w.run(2000)
    assert w.asked == []
    w.answer = ESC_STANDS
    w.run(400)
    assert w.asked == [], "some time after they began"
    w.run(600)
    assert w.asked == [10], "six times in a row are needed, nine by the oldest"
    w.answer = BEGINS
    w.run(2)
    w.answer = ESC_STANDS
    w.run(10_000)
    assert w.asked == []


def test_escs_that_know_no_more_are_asked_five_times(wired: Make) -> None:
    w = wired()
    w.answer = ESC_STANDS
    w.run(1500)
    assert w.asked == [], "the gyro is calibrated first"
    w.run(13_500)
    assert w.asked == [10] * 5


def test_escs_are_asked_again_when_they_have_started_anew(wired: Make) -> None:
    w = wired()
    w.run(2000)
    for _ in range(2):
        w.answer = ESC_STANDS
        w.run(1000)
        assert w.asked == [10]
        w.answer = BEGINS
        w.run(2)
        w.answer = ESC_SILENT
        w.run(100)


def test_nothing_is_asked_while_the_arm_switch_is_on(wired: Make) -> None:
    w = wired()
    w.boot()
    w.answer, w.arm = ESC_STANDS, 2000
    w.run(50)
    assert w.safety.arming_flags == 0, "armed"
    w.run(5000)
    assert not any(DshotCommand.EXTENDED_TELEMETRY in frame for frame in w.sent)


def test_what_escs_tell_is_told_over_msp_until_they_are_silent(wired: Make) -> None:
    w = wired()
    w.answer = ESC_STANDS
    w.run(3)
    for word in (BEGINS, TEMPERATURE, VOLTAGE, ESC_STANDS):
        w.answer = word
        w.run(1)
    told = motor_telemetry(w.ask(Msp.MOTOR_TELEMETRY))
    assert {(esc.temperature_c, esc.volts, esc.amps) for esc in told} == {(45, 16.0, 0.0)}
    assert w.fw.rotors.known[0] == sum(
        1 << kind for kind in (EscTold.STATE, EscTold.TEMPERATURE, EscTold.VOLTAGE)
    )
    w.answer = ESC_SILENT
    w.run(100)
    assert {esc.temperature_c for esc in motor_telemetry(w.ask(Msp.MOTOR_TELEMETRY))} == {0}
