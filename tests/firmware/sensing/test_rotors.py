"""rotors.c: words of ESCs to rotor speeds, and which of them count."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.physics.esc import rotor_words, words_speed
from neuroflight.toolchain.contract import (
    ESC_DAMAGED,
    ESC_SILENT,
    ESC_STANDS,
    ESC_WORD_MAX,
    ROTOR_ACCELERATION_MAX,
    ROTOR_ACCELERATION_USUAL,
    ROTOR_HOLD_MS,
    ROTOR_SPEED_MAX,
    EscTold,
)

MOTORS, RATE_HZ = 4, 1000
ROOM = ROTOR_ACCELERATION_MAX / RATE_HZ  # rad/s in a control step
USUAL = ROTOR_ACCELERATION_USUAL / RATE_HZ


class Rotors:
    """The rotors of four motors, each wired to the output of its number unless told otherwise."""

    def __init__(self, core: Any, outputs: Sequence[int] = range(MOTORS), **settings: float) -> None:
        self._core = core
        chosen = core.new("struct nf_settings *")
        core.lib.settings_default(chosen)
        for name, value in {"motor_telemetry": 1, **settings}.items():
            setattr(chosen, name, value)
        self.struct = core.new("struct rotors *")
        core.lib.rotors_init(self.struct, chosen, RATE_HZ)
        self._outputs = core.new("uint8_t[]", list(outputs))

    def step(self, *words: int) -> None:
        """A control step with these words; all outputs the first one's where there is no other."""
        given = list(words) if len(words) > 1 else [words[0]] * MOTORS
        told = self._core.new("uint16_t[8]", given + [ESC_SILENT] * (8 - len(given)))
        self._core.lib.rotors_step(self.struct, told, self._outputs)

    def speeds(self, *speeds: float) -> None:
        self.step(*rotor_words(np.array(speeds)).tolist())

    @property
    def speed(self) -> list[float]:
        return list(self.struct.speed)

    @property
    def silent(self) -> list[int]:
        """Numbers of the motors."""
        return [motor + 1 for motor in range(MOTORS) if self.struct.silent >> motor & 1]

    @property
    def errors(self) -> int:
        """Of motor 1 [0.01 %]."""
        return int(self._core.lib.rotors_errors(self.struct, 0))


@pytest.fixture
def rotors(scripted: Any) -> Rotors:
    """Four rotors at 1000 rad/s."""
    made = Rotors(scripted)
    made.speeds(1000.0)
    made.speeds(1000.0)
    assert made.silent == []
    return made


def test_every_word_is_a_speed_with_the_twins_bits_or_extended_telemetry(scripted: Any) -> None:
    lib = scripted.lib
    speeds = [word for word in range(ESC_WORD_MAX + 1) if lib.rotors_tells_speed(word)]
    others = set(range(1, ESC_WORD_MAX + 1)) - set(speeds)
    assert {word >> 8 for word in others} == {2 * (kind + 1) for kind in EscTold}
    kept = words_speed(np.array(speeds, np.uint16))
    for word, speed in zip(speeds[::3], kept[::3].tolist(), strict=True):
        if speed <= ROTOR_SPEED_MAX:
            rotors = Rotors(scripted)
            rotors.step(word)
            rotors.step(word)
            assert rotors.speed[0] == speed and rotors.silent == []
            assert word == ESC_STANDS or rotor_words(np.array([speed * (1 - 1e-6)]))[0] == word


@pytest.mark.parametrize("word", [0, ESC_DAMAGED, ESC_SILENT, 0x1000, 0xF000])
def test_what_is_no_word_is_an_error_and_the_speed_holds(rotors: Rotors, word: int) -> None:
    before = rotors.speed
    for _ in range(ROTOR_HOLD_MS):
        rotors.step(word)
        assert rotors.silent == [] and rotors.speed == before
    rotors.step(word)
    assert rotors.silent == [1, 2, 3, 4]
    assert rotors.errors == 10_000


def test_a_motor_is_named_by_its_own_number_when_it_is_wired_to_another_output(scripted: Any) -> None:
    rotors = Rotors(scripted, outputs=[2, 0, 1, 3])
    for _ in range(3):
        rotors.step(*rotor_words(np.array([100.0, 200.0, 300.0])).tolist(), ESC_SILENT)
    assert rotors.speed[:3] == pytest.approx([300.0, 100.0, 200.0], rel=0.005)
    assert rotors.silent == [4]


def test_poles_are_as_set(scripted: Any) -> None:
    rotors = Rotors(scripted, motor_poles=12)
    for _ in range(2):
        rotors.step(int(rotor_words(np.array([1000.0]), poles=12)[0]))
    assert rotors.speed[0] == pytest.approx(1000.0, rel=0.004)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_speed_counts_at_once_as_far_as_rotors_go_in_flight(rotors: Rotors, sign: int) -> None:
    beyond, within = 1000.0 + sign * (USUAL + 25.0), 1000.0 + sign * (USUAL - 10.0)
    rotors.speeds(beyond)
    assert rotors.speed[0] == pytest.approx(1000.0, rel=0.004), "forged"
    rotors.speeds(1000.0)
    rotors.speeds(within)
    assert rotors.speed[0] == pytest.approx(within, rel=0.004)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_counts_when_the_next_word_agrees_as_far_as_physics_allows(rotors: Rotors, sign: int) -> None:
    def jumps(by: float, then: float) -> bool:
        """From 1000 rad/s by so much, and a step later by so much."""
        for _ in range(3):
            rotors.speeds(1000.0)
        rotors.speeds(1000.0 + sign * by)
        assert rotors.speed[0] == pytest.approx(1000.0, rel=0.004)
        rotors.speeds(1000.0 + sign * then)
        return rotors.speed[0] == pytest.approx(1000.0 + sign * then, rel=0.004)

    assert jumps(ROOM, ROOM + 20.0)
    assert jumps(ROOM, 2 * ROOM - 10.0)
    assert not jumps(ROOM, 2 * ROOM + 30.0), "beyond physics"
    assert not jumps(-ROOM, ROOM - 10.0), "they do not agree"


def test_a_jump_is_forgotten_when_another_word_comes_between(rotors: Rotors) -> None:
    for between in (ESC_DAMAGED, 0x0228):  # a temperature
        rotors.speeds(1000.0)
        rotors.speeds(1000.0 + ROOM)
        rotors.step(between)
        rotors.speeds(1000.0 + 3 * USUAL + 40.0)
        assert rotors.speed[0] == pytest.approx(1000.0, rel=0.004)


def test_a_speed_may_change_the_further_the_longer_no_word_came(rotors: Rotors) -> None:
    for _ in range(2):
        rotors.step(ESC_DAMAGED)
    rotors.speeds(1000.0 + 2.9 * USUAL)
    assert rotors.speed[0] == pytest.approx(1000.0 + 2.9 * USUAL, rel=0.004)


def test_behind_a_silence_two_words_must_agree(rotors: Rotors) -> None:
    for _ in range(ROTOR_HOLD_MS + 1):
        rotors.step(ESC_SILENT)
    for speed in (500.0, 2000.0, 900.0):
        rotors.speeds(speed)
        assert rotors.silent == [1, 2, 3, 4]
    rotors.step(ESC_DAMAGED)
    rotors.speeds(900.0)
    assert rotors.silent == [1, 2, 3, 4], "not one behind the other"
    rotors.speeds(910.0)
    assert rotors.silent == [] and rotors.speed[0] == pytest.approx(910.0, rel=0.004)


def test_no_speed_that_no_rotor_has_is_ever_kept(scripted: Any) -> None:
    rotors = Rotors(scripted)
    for _ in range(20):
        rotors.speeds(ROTOR_SPEED_MAX * 1.1)
    assert rotors.silent == [1, 2, 3, 4] and rotors.speed[0] == 0.0


def test_errors_are_those_of_the_second_before(rotors: Rotors) -> None:
    rng = np.random.default_rng(4)
    good = int(rotor_words(np.array([1000.0]))[0])
    for _ in range(2):
        lost = np.zeros(RATE_HZ, bool)
        lost[rng.choice(np.arange(0, RATE_HZ, 2), 100, replace=False)] = True
        for each in lost:
            rotors.step(ESC_DAMAGED if each else good)
    assert rotors.errors == 1000
    for _ in range(2 * RATE_HZ):
        rotors.step(good)
    assert rotors.errors == 0


def test_extended_telemetry_is_no_error_and_no_speed(rotors: Rotors) -> None:
    before, bad = rotors.speed, rotors.struct.bad[0]
    for kind in EscTold:
        rotors.step((2 * (kind + 1)) << 8 | 40 + kind)
        rotors.speeds(1000.0)
    assert rotors.speed == before and rotors.struct.bad[0] == bad
    assert list(rotors.struct.told[0]) == [40 + kind for kind in EscTold]
    assert rotors.struct.known[0] == 0x7F


def test_random_words_are_seldom_believed_and_never_far_off(rotors: Rotors) -> None:
    """The wire's own checks pass one random answer of 256 or fewer: here they pass all."""
    rng = np.random.default_rng(5)
    good, believed = int(rotor_words(np.array([1000.0]))[0]), 0
    for _ in range(4000):
        before = rotors.speed[0]
        rotors.step(int(rng.integers(1, ESC_WORD_MAX + 1)))
        believed += rotors.speed[0] != before
        assert abs(rotors.speed[0] - 1000.0) < ROOM * 1.1
        rotors.step(good)
    assert believed < 4000 / 20
