"""Rates of sticks by a header's settings, against plain computations of one stick and published figures."""

from __future__ import annotations

import numpy as np
import pytest

from neuroflight.sim.blackbox.firmware import Firmware, Maker
from neuroflight.sim.blackbox.rates import RatesError, Style, readings

CASES = 1000
SEED = 20260927
BETAFLIGHT = Firmware(Maker.BETAFLIGHT, (4, 3, 0))


def one_stick(style: Style, x: float, rate: int, top: int, expo: int, *, bent: bool = False) -> float:
    """Return deg/s of one stick -1..1, step by step as each style's documentation describes it."""
    if x < 0:
        return -one_stick(style, -x, rate, top, expo, bent=bent)
    e = expo / 100
    if style is Style.BETAFLIGHT:
        rc_rate = rate / 100
        if rc_rate > 2:
            rc_rate = rc_rate + (rc_rate - 2) * 14.54
        command = x**4 * e + x * (1 - e)
        room = 1 - (command if bent else x) * top / 100
        return 200 * rc_rate * command / min(max(room, 0.01), 1)
    if style is Style.RACEFLIGHT:
        command = x + e * (x**3 - x)
        return command * rate * 10 + command * rate * 10 * x * top / 100
    if style is Style.KISS:
        command = x**3 * e + x * (1 - e)
        return 2000 * command * rate / 1000 / min(max(1 - x * top / 100, 0.01), 1)
    if style is Style.ACTUAL:
        centre, most = rate * 10, top * 10
        return x * centre + max(0, most - centre) * (x**6 * e + x**2 * (1 - e))
    if style is Style.QUICK:
        centre = rate * 2
        most = max(top * 10, centre)
        command = x**3 * e + x * (1 - e)
        factor = (most / centre - 1) / (most / centre)
        if bent:
            return command * centre / min(max(1 - x * factor, 0.01), 1)
        return x * centre / min(max(1 - command * factor, 0.01), 1)
    return float(rate * 5 * (x * (1 - e) + x ** (top / 16 + 2) * e))


def header(rng: np.random.Generator) -> tuple[dict[str, str], np.ndarray]:
    numbers = np.column_stack(
        [
            rng.integers(1, 256, 3),
            rng.integers(0, 201, 3),
            rng.integers(0, 101, 3),
            rng.integers(200, 1999, 3),
        ]
    )
    names = ("rc_rates", "rates", "rc_expo", "rate_limits")
    return {
        name: ",".join(map(str, column)) for name, column in zip(names, numbers.T.tolist(), strict=True)
    }, numbers


@pytest.mark.parametrize("style", list(Style), ids=lambda style: style.name)
def test_each_style_is_its_formula_when_the_header_has_any_numbers(style: Style) -> None:
    rng = np.random.default_rng((SEED, style))
    firmware = Firmware(Maker.ROTORFLIGHT if style is Style.ROTORFLIGHT else Maker.BETAFLIGHT, (4, 2))
    for _ in range(CASES):
        lines, numbers = header(rng)
        dead = rng.integers(0, 33, 2) if firmware.maker is Maker.BETAFLIGHT else (0, 0)
        full = 500 - np.array([dead[0], dead[0], dead[1]])
        bent = style is Style.QUICK and bool(rng.integers(2))
        lines |= {"rates_type": str(style.value), "deadband": str(dead[0]), "yaw_deadband": str(dead[1])}
        lines |= {"quickrates_rc_expo": "ON" if bent else "OFF"}
        sticks = np.rint(rng.uniform(-1, 1, (7, 3)) * full)
        (reading,) = readings(lines, firmware)
        expected = [
            [
                np.clip(one_stick(style, x, rate, top, expo, bent=bent), -limit, limit)
                for x, (rate, top, expo, limit) in zip(row, numbers.tolist(), strict=True)
            ]
            for row in (sticks / full).tolist()
        ]
        assert np.abs(reading.curve(sticks) - expected).max() < 1e-8, (lines, sticks)


@pytest.mark.parametrize(
    ("style", "rate", "top", "expo", "most"),
    [  # full-stick figures of Betaflight's app for its defaults
        (Style.BETAFLIGHT, 100, 70, 0, 667),
        (Style.RACEFLIGHT, 37, 80, 50, 666),
        (Style.KISS, 100, 70, 0, 667),
        (Style.ACTUAL, 7, 67, 0, 670),
        (Style.QUICK, 100, 67, 0, 670),
    ],
)
def test_full_stick_is_what_betaflights_app_shows(
    style: Style, rate: int, top: int, expo: int, most: int
) -> None:
    lines = {
        "rates_type": str(style.value),
        "rc_rates": f"{rate},{rate},{rate}",
        "rates": f"{top},{top},{top}",
    }
    (reading,) = readings({**lines, "rc_expo": f"{expo},{expo},{expo}"}, BETAFLIGHT)
    assert np.rint(reading.curve(np.array([[500.0, -500.0, 0.0]]))).tolist() == [[most, -most, 0]]


def test_lines_of_old_firmwares_are_read() -> None:
    old = {"rcRate": "105", "rcExpo": "10", "rcYawRate": "90", "rcYawExpo": "0", "rates": "78,70,60"}
    middle = {"rc_rate": "105", "rc_expo": "10", "rc_rate_yaw": "90", "rc_expo_yaw": "0", "rates": "78,70,60"}
    new = {"rc_rates": "105,105,90", "rc_expo": "10,10,0", "rates": "78,70,60", "rates_type": "0"}
    sticks = np.array([[133.0, -115.0, 97.0], [500.0, 500.0, -500.0]])
    settings = ((105, 78, 10), (105, 70, 10), (90, 60, 0))
    expected = [
        [one_stick(Style.BETAFLIGHT, x, *numbers) for x, numbers in zip(row, settings, strict=True)]
        for row in (sticks / 500).tolist()
    ]
    for version, lines in (((3, 1, 7), old), ((3, 2, 0), middle), ((4, 1, 0), new)):
        (reading,) = readings(lines, Firmware(Maker.BETAFLIGHT, version))
        assert np.abs(reading.curve(sticks) - expected).max() < 1e-9
    # Before 3.1.4 the expo bends what the super rate sees.
    (reading,) = readings(old, Firmware(Maker.BETAFLIGHT, (3, 1, 3)))
    assert reading.curve(sticks)[0, 0] == pytest.approx(
        one_stick(Style.BETAFLIGHT, 0.266, 105, 78, 10, bent=True)
    )


@pytest.mark.parametrize(
    ("firmware", "names"),
    [
        (Firmware(Maker.BETAFLIGHT, (3, 2, 5)), {"Betaflight"}),
        (Firmware(Maker.BETAFLIGHT, (3, 5, 7)), {"Betaflight", "Raceflight"}),
        (Firmware(Maker.BETAFLIGHT, (4, 1, 0)), {"Betaflight", "Raceflight", "KISS"}),
        (Firmware(Maker.BETAFLIGHT, (4, 3, 0)), {"Betaflight", "Raceflight", "KISS", "Actual", "Quick"}),
        (Firmware(Maker.CLEANFLIGHT, (2, 1, 0)), {"Betaflight"}),
        (Firmware(Maker.EMUFLIGHT, (0, 3, 5)), {"Betaflight", "Raceflight", "KISS", "Actual"}),
        (Firmware(Maker.OTHER), {"Betaflight", "Raceflight", "KISS", "Actual", "Quick"}),
    ],
)
def test_a_log_that_does_not_name_its_style_has_each_that_its_firmware_knows(
    firmware: Firmware, names: set[str]
) -> None:
    lines = {"rc_rates": "100,100,100", "rc_expo": "10,10,10", "rates": "70,70,70"}
    assert {one.name.split()[0] for one in readings(lines, firmware)} == names


def test_inavs_rates_are_tens_of_deg_s_at_full_stick() -> None:
    (reading,) = readings({"rates": "70,60,20", "rc_expo": "70"}, Firmware(Maker.INAV, (7, 1, 2)))
    assert reading.curve(np.array([[500.0, -250.0, 100.0]])).tolist() == [[700, -300, 40]]


def test_controllers_before_betaflight_3_count_in_the_gyros_steps() -> None:
    """Compare with the formula in the sources of 2.9: rc (27 / 16) 4 counts / (1 - |stick| rates)."""
    lines = {"rcRate": "100", "rcYawRate": "80", "rates": "70,50,0", "gyro.scale": "0x3d79c190"}
    count, sticks = 0.0609756, np.array([[250.0, -500.0, 100.0]])
    (reading,) = readings({**lines, "features": str(1 << 23)}, Firmware(Maker.BETAFLIGHT, (2, 9, 0)))
    expected = [27 * 250 / 16 / 0.65 * 4 * count, -27 * 500 / 16 / 0.5 * 4 * count, 27 * 100 / 16 * 4 * count]
    assert np.abs(reading.curve(sticks) - expected).max() < 1e-3
    (reading,) = readings({**lines, "features": "0"}, Firmware(Maker.BETAFLIGHT, (2, 9, 0)))
    expected = [97 * 250 / 16 * 4 * count, -77 * 500 / 16 * 4 * count, 27 * 100 / 16 * 4 * count]
    assert np.abs(reading.curve(sticks) - expected).max() < 1e-3
    found = readings({"rates": "70,70,60", "gyro.scale": "0x3d79c190"}, Firmware(Maker.CLEANFLIGHT))
    lux, whole = (one.curve(sticks)[0] for one in found)
    assert np.abs(lux - [450, -900, 140]).max() < 1e-9
    assert np.abs(whole - [97 * 250 / 4 * count, -97 * 500 / 4 * count, 87 * 100 / 8 * count]).max() < 1e-3


@pytest.mark.parametrize(
    ("lines", "firmware", "message"),
    [
        ({}, BETAFLIGHT, "rc_rates"),
        ({"rc_rates": "1,1,1", "rates": "1,1,1"}, BETAFLIGHT, "rc_expo"),
        ({"rcRate": "100", "rates": "1,1,1"}, Firmware(Maker.BETAFLIGHT, (3, 1, 7)), "rc_rate_yaw"),
        ({"rc_rates": "a,1,1"}, BETAFLIGHT, "rc_rates is 'a,1,1', expected three numbers"),
        ({"rates_type": "7"}, BETAFLIGHT, "rates_type is '7', expected 0 to 4"),
        ({"rates_type": "5"}, BETAFLIGHT, "rates_type is '5', expected 0 to 4"),
        ({"rcRate": "100"}, Firmware(Maker.CLEANFLIGHT), "rates"),
        ({"rates": "70,70,70"}, Firmware(Maker.CLEANFLIGHT), "gyro_scale"),
    ],
)
def test_what_lacks_is_named(lines: dict[str, str], firmware: Firmware, message: str) -> None:
    with pytest.raises(RatesError) as error:
        readings(lines, firmware)
    assert message in str(error.value)
