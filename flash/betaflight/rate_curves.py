"""Betaflight's five kinds of rates, and each in a style of this firmware: exactly, or the nearest one.

Formulas and defaults: src/main/fc/rc.c and controlrate_profile.c of Betaflight v3.0.1 to 2026.6.1; the styles
of this firmware: firmware/src/receiver/rates.c.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.contract import (
    AXES,
    RATE_MAX_DEG_S,
    RC_RATE_DEG_S,
    RC_RATE_STEEP,
    RC_RATE_STEEPER,
    SUPER_ROOM_MIN,
)

LIMIT_DEG_S = 1998  # limit of every rate, unless a profile has a lower one
STICK = np.linspace(0.0, 1.0, 101)
STEPS = np.linspace(0.0, 1.0, 101)  # grid of each number that is fitted
FULL_STICK_SLACK = 0.5  # deg/s: the rounding in settings.c
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AxisRates:
    """An axis of a rate profile, in Betaflight's whole numbers."""

    rc_rate: int
    super_rate: int
    expo: int
    limit: int = LIMIT_DEG_S  # deg/s


@dataclass(frozen=True)
class Profile:
    """A rate profile."""

    kind: str  # BETAFLIGHT, RACEFLIGHT, KISS, ACTUAL, QUICK
    axes: Mapping[str, AxisRates]
    quick_rc_expo: bool = False  # of QUICK: the expo bends the whole curve


@dataclass(frozen=True)
class Style:
    """Rates of this firmware."""

    name: str
    values: dict[str, float]  # by setting
    off: float = 0.0  # deg/s: the largest difference from the profile
    axis: str = ""  # on which axis
    at: float = 0.0  # at which part of the stick


def nearest_style(profile: Profile) -> Style:
    """Return the style equal or nearest to `profile`. Raises ValueError for rates beyond this firmware's."""
    for axis, rates in profile.axes.items():
        if rates.rc_rate <= 0:
            raise ValueError(f"an RC rate of 0 turns nothing on {axis}")
        full = float(curve(profile, rates)[-1])
        if full > RATE_MAX_DEG_S + FULL_STICK_SLACK:
            raise ValueError(
                f"they ask for {full:.0f} deg/s at full stick on {axis}, and sticks here ask for at most "
                f"{RATE_MAX_DEG_S:g}; lower them in Betaflight, or set {axis}_rate and {axis}_max here"
            )
    exact = {axis: _exact(profile, rates) for axis, rates in profile.axes.items()}
    names = {found[0] for found in exact.values() if found is not None}
    if None not in exact.values() and len(names) == 1:
        return Style(names.pop(), _settings({axis: found[1] for axis, found in exact.items() if found}))
    return min((_fitted(profile, name) for name in ("betaflight", "actual")), key=lambda style: style.off)


def curve(profile: Profile, rates: AxisRates) -> Floats:
    """Return the commanded rate [deg/s] at each of STICK, positions in the stick's upper half."""
    x, expo, top = STICK, rates.expo / 100, rates.super_rate / 100
    cubic = x**3 * expo + x * (1 - expo)
    if profile.kind == "BETAFLIGHT":
        asked = _betaflight(x, _steep(rates.rc_rate / 100), top, expo)
    elif profile.kind == "RACEFLIGHT":
        asked = 10 * rates.rc_rate * x * (1 + expo * (x**2 - 1)) * (1 + x * top)
    elif profile.kind == "KISS":
        asked = 2 * rates.rc_rate * cubic / _room(x * top)
    elif profile.kind == "ACTUAL":
        asked = _actual(x, 10 * rates.rc_rate, 10 * rates.super_rate, expo)
    else:
        part = _quick_super(rates)
        asked = (
            2
            * rates.rc_rate
            * (cubic / _room(x * part) if profile.quick_rc_expo else x / _room(cubic * part))
        )
    return np.minimum(asked, min(rates.limit, LIMIT_DEG_S))


def _room(share: Floats) -> Floats:
    return np.clip(1 - share, SUPER_ROOM_MIN, 1)


def _quick_super(rates: AxisRates) -> float:
    return 1 - 2 * rates.rc_rate / max(10 * rates.super_rate, 2 * rates.rc_rate)


def _steep(rate: float) -> float:
    return rate + RC_RATE_STEEPER * max(rate - RC_RATE_STEEP, 0.0)


def _unsteep(counted: float) -> float:
    """Return the RC rate whose effective rate is `counted`, the inverse of `_steep`."""
    return (
        counted
        if counted <= RC_RATE_STEEP
        else (counted + RC_RATE_STEEPER * RC_RATE_STEEP) / (1 + RC_RATE_STEEPER)
    )


def _betaflight(x: Floats, counted: float, top: float, expo: float) -> Floats:
    return np.asarray(RC_RATE_DEG_S * counted * (x**4 * expo + x * (1 - expo)) / _room(x * top))


def _actual(x: Floats, centre: float, full: float, expo: float) -> Floats:
    return np.asarray(x * centre + max(full - centre, 0.0) * (x**6 * expo + x**2 * (1 - expo)))


def _exact(profile: Profile, rates: AxisRates) -> tuple[str, tuple[float, float, float]] | None:
    """Return style and numbers of this firmware that give exactly the same curve; None if there are none."""
    kind, expo, top = profile.kind, rates.expo / 100, rates.super_rate / 100
    numbers: dict[str, tuple[str, tuple[float, float, float]]] = {
        "BETAFLIGHT": ("betaflight", (rates.rc_rate / 100, top, expo)),
        "ACTUAL": ("actual", (10.0 * rates.rc_rate, 10.0 * rates.super_rate, expo)),
    }
    if rates.expo == 0:  # without expo all kinds equal one of this firmware's two
        numbers |= {
            "RACEFLIGHT": ("actual", (10.0 * rates.rc_rate, 10.0 * rates.rc_rate * (1 + top), 0.0)),
            "KISS": ("betaflight", (_unsteep(rates.rc_rate / 100), top, 0.0)),
            "QUICK": ("betaflight", (_unsteep(rates.rc_rate / 100), _quick_super(rates), 0.0)),
        }
    if kind not in numbers or float(_own(*numbers[kind])[-1]) > float(curve(profile, rates)[-1]) + 0.01:
        return None  # the profile's limit cuts it off
    return numbers[kind]


def _own(name: str, numbers: tuple[float, float, float]) -> Floats:
    """Return the curve of this firmware for these numbers."""
    rate, top, expo = numbers
    return (
        _betaflight(STICK, _steep(rate), top, expo)
        if name == "betaflight"
        else _actual(STICK, rate, top, expo)
    )


def _settings(axes: Mapping[str, tuple[float, float, float]]) -> dict[str, float]:
    return {
        f"{axis}_{what}": round(number, 6)
        for axis in AXES
        for what, number in zip(("rate", "max", "expo"), axes[axis], strict=True)
    }


def _fitted(profile: Profile, name: str) -> Style:
    """Fit the style `name`: the same rate at full stick, elsewhere the smallest difference."""
    found, worst = {}, (-1.0, "", 0.0)
    for axis, rates in profile.axes.items():
        found[axis] = _fit(curve(profile, rates), name)
        off = np.abs(_own(name, found[axis]) - curve(profile, rates))
        worst = max(worst, (float(off.max()), axis, float(STICK[int(off.argmax())])))
    return Style(name, _settings(found), *worst)


def _fit(wanted: Floats, name: str) -> tuple[float, float, float]:
    """Search a grid of expo and of super rate or centre rate for the smallest largest difference."""
    full = float(wanted[-1])
    best = (np.inf, (0.0, 0.0, 0.0))
    for share in STEPS[:-1]:
        if name == "betaflight":
            numbers = (_unsteep(full * (1 - share) / RC_RATE_DEG_S), float(share))
        else:
            numbers = (full * (1 - share), full)
        straight, bent = (_own(name, (*numbers, expo)) for expo in (0.0, 1.0))
        # Both curves are linear in the expo.
        off = np.abs(straight + STEPS[:, None] * (bent - straight) - wanted).max(axis=1)
        at = int(off.argmin())
        best = min(best, (float(off[at]), (*numbers, float(STEPS[at]))))
    return best[1]
