"""Rates of a stick, by the settings in a log's header: from rcCommand to the commanded deg/s.

A log without a setpoint has only the stick, rcCommand of -500 to 500, and the settings by which the firmware
made a rate of it. `readings` gives each way to read these; `sim.blackbox.proof` compares them with the gyro.
The formulas are those of the firmwares named in sim.blackbox.firmware, in a form of our own: an even function
of the stick's way 0..1, times the stick.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.blackbox.firmware import Firmware, Maker
from neuroflight.sim.blackbox.scales import gyro_count

FULL = 500.0  # rcCommand at full stick
LIMIT_DEG_S = 1998.0  # of Betaflight's setpoint, where no rate_limits are told
SUPER_ROOM = 0.01  # least divisor that a super rate leaves at full stick
RC_RATE_KNEE, RC_RATE_STEEP = 200.0, 15.54  # hundredths; beyond them an RC rate counts so many times
MULTIWII_LSB = 4.0  # gyro counts of one step of the old controllers' rate
SUPEREXPO = 1 << 23  # in the header line features
SETTINGS = "rates_type, rc_rates, rc_expo and rates"  # header lines that define rates


class Style(IntEnum):
    """Shape of the curve: the number of the header line rates_type."""

    BETAFLIGHT = 0
    RACEFLIGHT = 1
    KISS = 2
    ACTUAL = 3
    QUICK = 4
    ROTORFLIGHT = 5


# Of each firmware: before which version it had how many styles, the first ones.
_STYLES = {
    Maker.BETAFLIGHT: (((3, 3), 1), ((4,), 2), ((4, 2), 3)),
    Maker.CLEANFLIGHT: (((2, 3), 1), ((4,), 2)),
}


@dataclass(frozen=True, eq=False)
class Reading:
    """A way to read the sticks of a log."""

    name: str
    choice: str  # header line or lines that choose it
    curve: Callable[[Array], Array]  # rcCommand (N, 3) to deg/s (N, 3)


class RatesError(ValueError):
    """The header has no complete rates; the message says what is missing."""


def readings(header: Mapping[str, str], firmware: Firmware) -> tuple[Reading, ...]:
    """Return all readings that the header allows, at least one. Raises RatesError if there is none."""
    maker = firmware.maker
    if maker is Maker.INAV:
        return _inav(header)
    if "rates_type" in header:
        return _by_type(header, firmware, (_style(header, maker),))
    if maker in (Maker.CLEANFLIGHT, Maker.BASEFLIGHT) and firmware.version < (2,):
        return _multiwii(header, firmware)
    if maker is Maker.BETAFLIGHT and () < firmware.version < (2, 8):
        return _multiwii(header, firmware)
    if maker is Maker.BETAFLIGHT and () < firmware.version < (3,):
        return _betaflight_2(header, firmware)
    return _by_type(header, firmware, _styles(firmware))


def curve(
    style: Style, rate: float, top: float, expo: float, *, bent: bool = False
) -> Callable[[Array], Array]:
    """Return the function of the stick -1..1 that gives deg/s, of the header's numbers of one axis.

    rate, top, expo: rc_rates, rates, rc_expo. bent: expo also bends what the super rate sees, as before
    Betaflight 3.1.4; of QUICK, expo bends the rate rather than the super rate (quickrates_rc_expo).
    """
    part = expo / 100.0

    def bend(way: Array, power: int) -> Array:
        return 1.0 - part + part * way**power

    def raised(way: Array, by: float) -> Array:
        return 1.0 / np.clip(1.0 - way * by, SUPER_ROOM, 1.0)

    def betaflight(way: Array) -> Array:
        steep = rate + (RC_RATE_STEEP - 1.0) * max(0.0, rate - RC_RATE_KNEE)
        bowed = bend(way, 3)
        return 2.0 * steep * bowed * raised(way * bowed if bent else way, top / 100.0)

    def raceflight(way: Array) -> Array:
        return 10.0 * rate * bend(way, 2) * (1.0 + way * top / 100.0)

    def kiss(way: Array) -> Array:
        return 2.0 * rate * bend(way, 2) * raised(way, top / 100.0)

    def actual(way: Array) -> Array:
        return 10.0 * (rate + max(0.0, top - rate) * way * bend(way, 4))

    def quick(way: Array) -> Array:
        centre = 2.0 * rate
        room = 1.0 - centre / max(10.0 * top, centre) if centre else 0.0
        if bent:
            return centre * bend(way, 2) * raised(way, room)
        return centre * raised(way * bend(way, 2), room)

    def rotorflight(way: Array) -> Array:
        return 5.0 * rate * (1.0 - part + part * way ** (top / 16.0 + 1.0))

    slope = {
        Style.BETAFLIGHT: betaflight,
        Style.RACEFLIGHT: raceflight,
        Style.KISS: kiss,
        Style.ACTUAL: actual,
        Style.QUICK: quick,
        Style.ROTORFLIGHT: rotorflight,
    }[style]
    return lambda stick: stick * slope(np.abs(stick))


def _by_type(header: Mapping[str, str], firmware: Firmware, styles: tuple[Style, ...]) -> tuple[Reading, ...]:
    """Return a reading of rc_rates, rc_expo and rates for each of these styles."""
    rate = _axes(header, ("rc_rates", "rc_rate", "rcRate"), ("rc_rate_yaw", "rcYawRate"))
    expo = _axes(header, ("rc_expo", "rcExpo"), ("rc_expo_yaw", "rc_yaw_expo", "rcYawExpo"))
    top = _axes(header, ("rates",))
    limit = _axes(header, ("rate_limits",)) if "rate_limits" in header else (LIMIT_DEG_S,) * 3
    full = _full(header, firmware)
    old = firmware.maker is Maker.BETAFLIGHT and () < firmware.version < (3, 1, 4)
    found = []
    for style in styles:
        name = f"{style.name.capitalize() if style is not Style.KISS else style.name} rates"
        choice = f"rates_type={style.value}"
        kinds = [(name, choice, old and style is Style.BETAFLIGHT)]
        if style is Style.QUICK and any(expo):
            told = header.get("quickrates_rc_expo", "").strip().upper()
            kinds = [
                (f"{name} with expo on the {what}", f"{choice} quickrates_rc_expo={word}", word == "ON")
                for word, what in (("OFF", "super rate"), ("ON", "rate"))
                if told in (word, "")
            ]
        for named, chosen, bent in kinds:
            curves = [curve(style, *numbers, bent=bent) for numbers in zip(rate, top, expo, strict=True)]
            found.append(Reading(named, chosen, _joined(curves, full, limit)))
    if not found:
        raise RatesError("quickrates_rc_expo is neither ON nor OFF")
    return tuple(found)


def _joined(
    curves: list[Callable[[Array], Array]], full: tuple[float, ...], limit: tuple[float, ...]
) -> Callable[[Array], Array]:
    def rates(sticks: Array) -> Array:
        columns = [
            np.clip(one(sticks[:, axis] / full[axis]), -limit[axis], limit[axis])
            for axis, one in enumerate(curves)
        ]
        return np.stack(columns, axis=1)

    return rates


def _linear(name: str, choice: str, slopes: tuple[float, ...]) -> Reading:
    """Return a reading that is a constant factor: rcCommand already holds rate and expo."""
    return Reading(name, choice, lambda sticks: sticks * np.array(slopes))


def _inav(header: Mapping[str, str]) -> tuple[Reading, ...]:
    """Read INAV's rates: deg/s / 10 at full stick; rcCommand already holds the expo."""
    top = _axes(header, ("rates",))
    return (_linear("INAV's rates", "rates", tuple(10.0 * one / FULL for one in top)),)


def _multiwii(header: Mapping[str, str], firmware: Firmware) -> tuple[Reading, ...]:
    """Read the rates of the controllers before Betaflight 2.8: LuxFloat, and MultiWii's integer one.

    MultiWii's are in counts of the gyro. Cleanflight does not log `rates`: the user gives them.
    """
    roll, pitch, yaw = _axes(header, ("rates",))
    floats = ((roll + 20) / 50, (pitch + 20) / 50, (yaw + 10) / 50)
    lux = _linear("LuxFloat's rates", "pidController=2", floats)
    step = MULTIWII_LSB * _count_deg_s(header, firmware) / 16
    slopes = ((roll + 27) * step, (pitch + 27) * step)
    whole = _linear("MultiWii's rates", "pidController=1", (*slopes, (yaw + 27) * step / 2))
    if firmware.maker is Maker.BETAFLIGHT:
        return (lux, whole, _linear("Betaflight 2.7's rates", "", (*slopes, (yaw + 47) * step / 2)))
    number = header.get("pidController", "").strip()
    return {"1": (whole,), "2": (lux,)}.get(number, (lux, whole))


def _betaflight_2(header: Mapping[str, str], firmware: Firmware) -> tuple[Reading, ...]:
    """Read the rates of Betaflight 2.8 and 2.9: a feature tells whether `rates` are super rates."""
    top = _axes(header, ("rates",))
    step = MULTIWII_LSB * _count_deg_s(header, firmware) / 16
    features = _numbers(header.get("features", ""))
    if features is None or len(features) != 1:
        raise RatesError("features")
    if not int(features[0]) & SUPEREXPO:
        return (_linear("Betaflight 2's rates", "features", tuple((one + 27) * step for one in top)),)
    rate = _axes(header, ("rcRate",), ("rcYawRate",))

    def rates(sticks: Array) -> Array:
        way = np.abs(sticks) / (FULL * np.maximum(1.0, rate) / 100.0)
        room = np.clip(1.0 - way * np.array(top) / 100.0, SUPER_ROOM, 1.0)
        return np.asarray(sticks * 27.0 * step / room, np.float64)

    return (Reading("Betaflight 2's super rates", "features", rates),)


def _styles(firmware: Firmware) -> tuple[Style, ...]:
    """Return the possible styles of a firmware that does not log which style is chosen."""
    maker, version = firmware.maker, firmware.version
    for before, count in _STYLES.get(maker, ()) if version else ():
        if version < before:
            return tuple(Style)[:count]
    return _known(maker)[:4] if maker is Maker.EMUFLIGHT else _known(maker)


def _known(maker: Maker) -> tuple[Style, ...]:
    """Return all styles of a firmware's latest versions."""
    return tuple(one for one in Style if maker is Maker.ROTORFLIGHT or one is not Style.ROTORFLIGHT)


def _style(header: Mapping[str, str], maker: Maker) -> Style:
    number, known = _numbers(header["rates_type"]), _known(maker)
    if number is None or len(number) != 1 or number[0] not in known:
        raise RatesError(f"rates_type is {header['rates_type'][:20]!r}, expected 0 to {known[-1]}")
    return Style(int(number[0]))


def _full(header: Mapping[str, str], firmware: Firmware) -> tuple[float, ...]:
    """Return rcCommand at full stick. Betaflight since 4.2 subtracts the deadband, others do not."""
    if not (firmware.since(Maker.BETAFLIGHT, 4, 2) or firmware.since(Maker.CLEANFLIGHT, 4, 2)):
        return (FULL,) * 3
    dead = [_numbers(header.get(name, "0")) or (0.0,) for name in ("deadband", "yaw_deadband")]
    stick, yaw = (FULL - min(max(one[0], 0.0), 0.9 * FULL) for one in dead)
    return (stick, stick, yaw)


def _count_deg_s(header: Mapping[str, str], firmware: Firmware) -> float:
    """Return the deg/s of one gyro count, the unit of the old controllers' rates. Raises RatesError."""
    found = gyro_count(header, firmware)
    if found is None:
        raise RatesError("gyro_scale")
    return float(np.rad2deg(found))


def _axes(
    header: Mapping[str, str], names: tuple[str, ...], yaw: tuple[str, ...] = ()
) -> tuple[float, float, float]:
    """Return roll, pitch and yaw from the first line found of `names`; yaw's may be a line of its own."""
    name = next((one for one in names if one in header), None)
    if name is None:
        raise RatesError(names[0])
    found = _numbers(header[name])
    if found is not None and len(found) == 1 and yaw:
        own = next((one for one in yaw if one in header), None)
        if own is None:
            raise RatesError(yaw[0])
        turned = _numbers(header[own])
        if turned is not None and len(turned) == 1:
            return (found[0], found[0], turned[0])
        name, found = own, None
    if found is None or len(found) != 3:
        raise RatesError(f"{name} is {header[name][:20]!r}, expected three numbers")
    return (found[0], found[1], found[2])


def _numbers(text: str) -> tuple[float, ...] | None:
    """Read whole numbers separated by commas, with or without brackets; None for anything else."""
    parts = text.strip().strip("[]").split(",")
    if not all(re.fullmatch(r"\s*\d{1,10}\s*", part) for part in parts):
        return None
    return tuple(float(part) for part in parts)
