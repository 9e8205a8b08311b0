"""Betaflight's rates in a style of this firmware, against its formulas written out once more."""

from __future__ import annotations

import random

import pytest

from neuroflight.flash.betaflight.rate_curves import AxisRates, Profile, Style, nearest_style
from tests.sampling import examples

AXES = ("roll", "pitch", "yaw")
STICKS = [at / 200 for at in range(201)]


def asked(kind: str, rc: int, top: int, expo: int, x: float, quick: bool = False) -> float:
    """Return deg/s at x of a stick, 0 to 1, as rc.c of Betaflight 2025.12 computes it."""
    e, s = expo / 100, top / 100
    if kind == "BETAFLIGHT":
        bent = x * x**3 * e + x * (1 - e)
        rate = rc / 100
        if rate > 2:
            rate += 14.54 * (rate - 2)
        return min(200 * rate * bent / max(0.01, 1 - x * s), 1998)
    if kind == "RACEFLIGHT":
        return min(10 * rc * (1 + 0.01 * expo * (x * x - 1)) * x * (1 + x * top * 0.01), 1998)
    if kind == "KISS":
        return min(2000 / max(0.01, 1 - x * s) * (x**3 * e + x * (1 - e)) * rc / 1000, 1998)
    if kind == "ACTUAL":
        return min(x * rc * 10 + max(0, top * 10 - rc * 10) * x * (x**5 * e + x * (1 - e)), 1998)
    start = rc * 2
    most = max(top * 10, start)
    room = (most / start - 1) / (most / start)
    bent = x**3 * e + x * (1 - e)
    return min(bent * start / (1 - x * room) if quick else x * start / (1 - bent * room), 1998)


def flown(style: Style, axis: str, x: float) -> float:
    """Return deg/s of this firmware, as docs/reference/settings.md gives the formulas."""
    rate, top, e = (style.values[f"{axis}_{what}"] for what in ("rate", "max", "expo"))
    if style.name == "betaflight":
        counted = rate + 14.54 * max(rate - 2, 0)
        return 200 * counted * (x**4 * e + x * (1 - e)) / max(1 - x * top, 0.01)
    return x * rate + max(top - rate, 0) * (x**6 * e + x**2 * (1 - e))


def profile_of(kind: str, numbers: list[tuple[int, int, int]], quick: bool = False) -> Profile:
    return Profile(kind, {axis: AxisRates(*of) for axis, of in zip(AXES, numbers, strict=True)}, quick)


def largest_error(kind: str, numbers: list[tuple[int, int, int]], style: Style, quick: bool = False) -> float:
    return max(
        abs(flown(style, axis, x) - asked(kind, *of, x, quick))
        for axis, of in zip(AXES, numbers, strict=True)
        for x in STICKS
    )


RANGES = {  # of rc rate and super rate, where pilots have them
    "BETAFLIGHT": ((20, 205), (0, 85)),
    "RACEFLIGHT": ((10, 80), (0, 160)),
    "KISS": ((20, 220), (0, 80)),
    "ACTUAL": ((1, 60), (1, 160)),
    "QUICK": ((20, 250), (5, 160)),
}


def drawn(rng: random.Random, kind: str, expo: int) -> list[tuple[int, int, int]]:
    """Draw numbers of three axes whose rates this firmware can command."""
    low_high, tops = RANGES[kind]
    while True:
        numbers = [(rng.randint(*low_high), rng.randint(*tops), rng.randint(0, expo)) for _ in AXES]
        if all(asked(kind, *of, 1.0) <= 1600 for of in numbers):
            return numbers


@pytest.mark.parametrize(
    ("kind", "expo"), [("BETAFLIGHT", 100), ("ACTUAL", 100), ("RACEFLIGHT", 0), ("KISS", 0), ("QUICK", 0)]
)
def test_the_curve_is_the_same_where_a_style_has_it(kind: str, expo: int) -> None:
    rng = random.Random(kind)
    for _ in range(examples(200)):
        numbers = drawn(rng, kind, expo)
        style = nearest_style(profile_of(kind, numbers))
        assert style.off == 0.0
        # A super rate has six decimals: 5e-7 x 40 deg/s / 0.025^2, for an RC rate of 0.2 and 1600 deg/s.
        assert largest_error(kind, numbers, style) < 0.04, numbers


@pytest.mark.parametrize(
    ("kind", "quick"), [("RACEFLIGHT", False), ("KISS", False), ("QUICK", False), ("QUICK", True)]
)
def test_the_nearest_curve_ends_the_same_and_tells_how_far_off_it_is(kind: str, quick: bool) -> None:
    rng = random.Random(f"{kind}{quick}")
    for _ in range(1 + examples(8)):
        numbers = drawn(rng, kind, 60)
        style = nearest_style(profile_of(kind, numbers, quick))
        error = largest_error(kind, numbers, style, quick)
        assert error == pytest.approx(style.off, abs=1.0)  # told of each hundredth of the stick
        for axis, of in zip(AXES, numbers, strict=True):
            full = asked(kind, *of, 1.0, quick)
            assert flown(style, axis, 1.0) == pytest.approx(full, abs=0.5)
            assert error < 0.12 * max(asked(kind, *one, 1.0, quick) for one in numbers), numbers


def test_a_rate_limit_cuts_the_curve_that_is_come_near_to() -> None:
    rates = AxisRates(100, 70, 0, limit=500)
    style = nearest_style(Profile("BETAFLIGHT", dict.fromkeys(AXES, rates)))
    assert flown(style, "roll", 1.0) == pytest.approx(500, abs=0.5)
    assert style.off > 1.0


@pytest.mark.parametrize(
    ("rates", "words"),
    [
        (
            AxisRates(200, 80, 0),
            "they ask for 1998 deg/s at full stick on roll, and sticks here ask for at most 1600",
        ),
        (AxisRates(0, 70, 0), "an RC rate of 0"),
    ],
)
def test_rates_that_cannot_be_flown_are_refused(rates: AxisRates, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        nearest_style(Profile("BETAFLIGHT", dict.fromkeys(AXES, rates)))
