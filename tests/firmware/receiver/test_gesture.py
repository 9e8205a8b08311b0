"""gesture.c: the sticks that acknowledge, and those that do not."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import pytest

from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
    GESTURE_MS,
)

STEP_MS = 100
LOW, MIDDLE, HIGH = 1000, 1500, 2000
STICKS = (CHANNEL_THROTTLE, CHANNEL_YAW, CHANNEL_PITCH, CHANNEL_ROLL)
SHOWN = (LOW, LOW, LOW, HIGH)  # in the order of STICKS


class Gesture:
    """A gesture of its own, watched every STEP_MS."""

    def __init__(self, core: Any, start_ms: int = 0) -> None:
        self.core, self.ms = core, start_ms
        self.self = core.new("struct gesture *")
        core.lib.gesture_init(self.self)

    def hold(self, ms: int, at: tuple[int, ...] = SHOWN, *, allowed: bool = True) -> list[int]:
        """Sticks held for that long, at both ends; returns after how many ms they were told."""
        channels = [MIDDLE] * CHANNEL_COUNT
        for channel, us in zip(STICKS, at, strict=True):
            channels[channel] = us
        told = []
        for since in range(0, ms + 1, STEP_MS):
            now = (self.ms + since) & 0xFFFFFFFF
            if self.core.lib.gesture_step(self.self, channels, allowed, now):
                told.append(since)
        self.ms += ms + STEP_MS
        return told


@pytest.fixture
def gesture(scripted: Any) -> Callable[..., Gesture]:
    return lambda start_ms=0: Gesture(scripted, start_ms)


@pytest.mark.parametrize("start_ms", [0, 2**32 - 1500])
def test_it_is_told_once_when_it_is_held_long_enough(gesture: Callable[..., Gesture], start_ms: int) -> None:
    assert gesture(start_ms).hold(5 * GESTURE_MS) == [GESTURE_MS]


def test_it_is_told_again_only_when_it_was_left(gesture: Callable[..., Gesture]) -> None:
    g = gesture()
    assert g.hold(3 * GESTURE_MS) == [GESTURE_MS]
    assert g.hold(0, (LOW, MIDDLE, MIDDLE, MIDDLE)) == []
    assert g.hold(3 * GESTURE_MS) == [GESTURE_MS]


def test_no_other_position_says_it_when_held(gesture: Callable[..., Gesture]) -> None:
    for at in product((LOW, MIDDLE, HIGH), repeat=4):
        assert at == SHOWN or gesture().hold(2 * GESTURE_MS, at) == [], at


@pytest.mark.parametrize("stick", range(4))
def test_sticks_must_stand_at_their_ends_when_they_are_to_say_it(
    gesture: Callable[..., Gesture], stick: int
) -> None:
    ends = (1050, 1100, 1100, 1900)
    short = tuple(us + (-1 if us == 1900 else 1) if i == stick else us for i, us in enumerate(ends))
    assert gesture().hold(GESTURE_MS, ends) == [GESTURE_MS]
    assert gesture().hold(2 * GESTURE_MS, short) == []


def test_the_time_begins_anew_when_it_was_interrupted_or_not_allowed(gesture: Callable[..., Gesture]) -> None:
    g = gesture()
    assert g.hold(GESTURE_MS - STEP_MS) == []
    assert g.hold(0, (LOW, LOW, LOW, MIDDLE)) == []
    assert g.hold(GESTURE_MS - STEP_MS) == []
    assert g.hold(3 * GESTURE_MS, allowed=False) == []
    assert g.hold(GESTURE_MS) == [GESTURE_MS]
