"""rates.c: sticks to setpoint and throttle, against the public formulas in float64."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.ports.port import FLIGHT_RATES
from neuroflight.toolchain.contract import (
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_THROTTLE,
    CHANNEL_YAW,
    RATE_MAX_DEG_S,
)
from tests.sampling import examples

CHANNELS = (CHANNEL_ROLL, CHANNEL_PITCH, CHANNEL_YAW)
NAMES = ("roll", "pitch", "yaw")
SIGNS = (1, 1, -1)  # yaw: channel high turns right, body yaw is positive to the left
ACTUAL, BETAFLIGHT = 0, 1
RATE_MAX = RATE_MAX_DEG_S


class Rates:
    """The module with settings of its own."""

    def __init__(self, core: Any, **changed: float) -> None:
        self.core, self.self = core, core.new("struct rates *")
        values = core.new("struct nf_settings *")
        core.lib.settings_default(values)
        for name, value in changed.items():
            setattr(values, name, value)
        core.lib.rates_init(self.self, values)
        self.out = core.new("float[3]")

    def setpoint(self, channels: list[int]) -> list[float]:
        self.core.lib.rates_setpoint(self.self, channels, self.out)
        return list(self.out)

    def at(self, us: int) -> list[float]:
        """All channels at `us`, roll's sign for every axis."""
        return [sign * value for sign, value in zip(SIGNS, self.setpoint([us] * 16), strict=True)]


def way(us: int, deadband: int) -> float:
    """Where the stick is, -1..1."""
    offset = np.clip(us, 1000, 2000) - 1500
    return float(np.sign(offset) * max(abs(offset) - deadband, 0) / (500 - deadband))


def actual(x: float, centre: float, most: float, expo: float) -> float:
    """deg/s; the formula of the Actual rates."""
    expof = abs(x) * (x**5 * expo + x * (1 - expo))
    return float(np.clip(x * centre + max(0.0, most - centre) * expof, -RATE_MAX, RATE_MAX))


def betaflight(x: float, rc_rate: float, super_rate: float, expo: float) -> float:
    """deg/s; the formula of the Betaflight rates."""
    command = x * abs(x) ** 3 * expo + x * (1 - expo)
    if rc_rate > 2:
        rc_rate += 14.54 * (rc_rate - 2)
    rate = 200 * rc_rate * command / min(max(1 - abs(x) * super_rate, 0.01), 1.0)
    return float(np.clip(rate, -RATE_MAX, RATE_MAX))


FORMULAS = {ACTUAL: actual, BETAFLIGHT: betaflight}


# --- As set by default, and for simulated flights -----------------------------------------------
def test_the_aircraft_turns_as_under_betaflight_when_nothing_is_set(scripted: Any) -> None:
    rates = Rates(scripted)
    for us in range(1000, 2001):
        x = (us - 1500) / 500
        expected = [math.radians(actual(x, 70.0, 670.0, 0.0))] * 3
        np.testing.assert_allclose(rates.at(us), expected, rtol=1e-5, atol=1e-7)


def test_setpoint_has_the_bits_of_one_product_when_rates_are_those_of_flights(scripted: Any) -> None:
    """offset 0.002 clamped, times full stick: what every flight before the styles was flown with."""
    rates = Rates(scripted, **FLIGHT_RATES)
    full_stick = np.float32(17.453292519943297)
    for us in [*range(800, 2300), 0, 65535]:
        x = np.clip(np.float32(us - 1500) * np.float32(0.002), np.float32(-1), np.float32(1))
        expected = [x * full_stick, x * full_stick, x * -full_stick]
        assert np.array(rates.setpoint([us] * 16), np.float32).tobytes() == np.array(expected).tobytes(), us


@pytest.mark.parametrize("axis", range(3))
def test_one_axis_turns_when_one_stick_moves(scripted: Any, axis: int) -> None:
    rates = Rates(scripted, **FLIGHT_RATES)
    for us in range(1000, 2001):
        channels = [1500] * 16
        channels[CHANNELS[axis]] = us
        expected = np.zeros(3)
        expected[axis] = SIGNS[axis] * math.radians(1000) * (us - 1500) / 500
        np.testing.assert_allclose(rates.setpoint(channels), expected, rtol=2.5e-7, atol=0)


# --- The formulas -----------------------------------------------------------------------------
def check(core: Any, style: int, numbers: list[tuple[float, float, float]], deadbands: list[int]) -> None:
    changed: dict[str, float] = {
        "rates_style": style,
        "deadband_us": deadbands[0],
        "yaw_deadband_us": deadbands[2],
    }
    for name, (rate, most, expo) in zip(NAMES, numbers, strict=True):
        changed |= {f"{name}_rate": rate, f"{name}_max": most, f"{name}_expo": expo}
    rates = Rates(core, **changed)
    for us in [*range(990, 2011, 3), 1499, 1500, 1501, 0, 65535]:
        expected = [
            math.radians(FORMULAS[style](way(us, deadband), *of_axis))
            for of_axis, deadband in zip(numbers, deadbands, strict=True)
        ]
        np.testing.assert_allclose(rates.at(us), expected, rtol=1e-4, atol=1e-7, err_msg=f"{us} us")


@pytest.mark.parametrize(("style", "most_rate", "most_max"), [(ACTUAL, 1000, 1998), (BETAFLIGHT, 3, 1)])
def test_rates_follow_their_formula_when_numbers_are_random(
    scripted: Any, style: int, most_rate: float, most_max: float
) -> None:
    """Each number at its end in one draw of five."""
    rng = np.random.default_rng(1)

    def draw(low: float, high: float) -> float:
        value = rng.choice([low, high]) if rng.random() < 0.2 else rng.uniform(low, high)
        return float(np.float32(value))

    for _ in range(examples(80)):
        numbers = [(draw(0.01, most_rate), draw(0, most_max), draw(0, 1)) for _ in range(3)]
        level, yaw = rng.integers(0, 101, 2).tolist()
        check(scripted, style, numbers, [level, level, yaw])


def test_known_rates_come_out_when_set_as_pilots_do(scripted: Any) -> None:
    """Betaflight's old default 1.0, 0.70, 0.00 ends at 666.7 deg/s; actual 70, 670 at 70 and 670."""
    old = Rates(scripted, rates_style=BETAFLIGHT, roll_rate=1.0, roll_max=0.7, roll_expo=0.0)
    assert math.degrees(old.at(2000)[0]) == pytest.approx(666.667, abs=0.01)
    new = Rates(scripted, roll_rate=70.0, roll_max=670.0, roll_expo=0.0)
    assert math.degrees(new.at(2000)[0]) == pytest.approx(670, abs=0.01)
    assert math.degrees(new.at(1505)[0]) == pytest.approx(0.70 + 600 * 0.01**2, abs=1e-4)


@pytest.mark.parametrize("style", [ACTUAL, BETAFLIGHT])
def test_the_rate_ends_below_the_gyros_range_when_more_is_set(scripted: Any, style: int) -> None:
    most = 1998 if style == ACTUAL else 1.0
    rates = Rates(scripted, rates_style=style, roll_rate=1000.0 if style == ACTUAL else 2.55, roll_max=most)
    for us, sign in ((2000, 1), (1000, -1)):
        assert rates.at(us)[0] == pytest.approx(sign * math.radians(RATE_MAX_DEG_S), rel=1e-6)


def test_throttle_is_linear_and_clamped_when_the_stick_moves(scripted: Any) -> None:
    for us in [0, 880, *range(1000, 2001), 2159, 65535]:
        channels = [1500] * 16
        channels[CHANNEL_THROTTLE] = us
        expected = min(max((us - 1000) / 1000, 0), 1)
        assert scripted.lib.rates_throttle(channels) == pytest.approx(expected, rel=2.5e-7, abs=0)
