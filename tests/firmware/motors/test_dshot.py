"""dshot.c: fractions to values, values to frames."""

from __future__ import annotations

import math
from functools import reduce
from operator import xor
from typing import Any

import numpy as np
import pytest


@pytest.mark.parametrize(
    ("value", "telemetry", "frame"),
    [
        (1046, False, 0b1000001011000110),  # the example of the format's public description
        (0, False, 0x0000),
        (48, False, 0x0606),
        (2047, False, 0xFFEE),
        (2047, True, 0xFFFF),
    ],
)
def test_frame_is_the_known_one_when_the_value_is(
    scripted: Any,
    value: int,
    telemetry: bool,
    frame: int,
) -> None:
    assert scripted.lib.dshot_frames(value | value << 16, telemetry, False) == frame | frame << 16


@pytest.mark.parametrize("answered", [False, True])
def test_every_frame_checks_when_its_nibbles_are_xored(scripted: Any, answered: bool) -> None:
    for value in range(2048):
        for telemetry in (False, True):
            beside = 2047 - value
            frames = scripted.lib.dshot_frames(value | beside << 16, telemetry, answered)
            for frame, sent in ((frames & 0xFFFF, value), (frames >> 16, beside)):
                nibbles = ((frame >> shift) & 0xF for shift in (0, 4, 8, 12))
                assert reduce(xor, nibbles) == (15 if answered else 0)
                assert frame >> 5 == sent
                assert bool(frame >> 4 & 1) is telemetry


def test_value_is_the_nearest_step_when_the_fraction_is_random(scripted: Any) -> None:
    rng = np.random.default_rng(5)
    for fraction in rng.random(5000).astype(np.float32).tolist():
        exact = 48 + 1999 * fraction
        value = scripted.lib.dshot_value(fraction)
        assert abs(value - exact) <= 0.5 + 1e-4
    assert [scripted.lib.dshot_value(step / 1999) for step in range(2000)] == list(range(48, 2048))


@pytest.mark.parametrize(
    ("fraction", "value"),
    [
        (-0.0, 48),
        (-1e9, 48),
        (-math.inf, 48),
        (1.0, 2047),
        (1.0000001, 2047),
        (math.inf, 2047),
        (math.nan, 0),
    ],
)
def test_value_stays_a_throttle_or_stops_when_the_fraction_is_none(
    scripted: Any,
    fraction: float,
    value: int,
) -> None:
    assert scripted.lib.dshot_value(fraction) == value
