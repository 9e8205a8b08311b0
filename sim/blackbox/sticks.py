"""The pilot's commands in a log: rates and thrust, from whichever field the firmware wrote them to.

Betaflight since 4.0 and our own firmware log the setpoint, INAV the target of its rate controller (axisRate).
Others log the stick only, of which the rates in the header make a command. A value that no stick can have is
damage, or a field that was read wrong: nothing may be flown from it (`check`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.blackbox.firmware import Firmware, Maker, has_box_mask, has_mapped_throttle
from neuroflight.sim.blackbox.headers import DEFAULTS
from neuroflight.sim.blackbox.log import Log
from neuroflight.sim.blackbox.proof import choose
from neuroflight.sim.blackbox.rates import SETTINGS, RatesError, readings
from neuroflight.sim.blackbox.scales import fine, header_number
from neuroflight.toolchain.contract import AXES, CHANNEL_MAX_US, CHANNEL_MIN_US
from neuroflight.toolchain.errors import TraceError

RATE_MOST_DEG_S = 2000.0  # no firmware commands more: Betaflight's settings end at 1998
SLACK = 0.115  # of a stick beyond its ends: receivers give, and Betaflight takes, pulses of 885 to 2115 us
THROTTLE_COUNTS = 1000.0  # of setpoint[3] at full thrust
ROUNDED_DEG_S = 0.51  # by which rounding to whole deg/s or float32 may exceed a limit
AIRBORNE = 0.1  # throttle from which a flight is taken to follow its commands
TELL_RATES = frozenset(("rates_type", "rates", "pidController"))  # a user who gives one chose the rates
ANGLE_BITS, ANGLE_FLAGS = 0b110, 0b11  # ANGLE and HORIZON, as boxes and as flags of modes


@dataclass(frozen=True, eq=False)
class Pilot:
    """The pilot's commands in N rows; None where the log does not show them."""

    rates: Array | None = None  # (N, 3) [deg/s]; NaN where the stick commanded an angle
    throttle: Array | None = None  # (N,) of full thrust, beyond 0..1 where the log's number is no stick's
    source: str = ""  # the field that rates come from
    level: Flags | None = None  # (N,) whether ANGLE or HORIZON mode is on: the stick commands an angle
    note: str = ""  # for the user, on how they were read
    lacks: str = ""  # why there are none, and what the user can do


def pilot(log: Log, firmware: Firmware, gyro: Array | None, armed: Flags) -> Pilot:
    """Read the commands of the sticks; gyro (N, 3) [deg/s], armed (N,)."""
    parts, level = fine(log.header), _level(log, firmware)
    throttle = _throttle(log, firmware, parts)
    setpoint = log.matrix("setpoint", 3)
    if setpoint is not None:
        counts = log.columns.get("setpoint[3]")
        if counts is not None and firmware.maker is not Maker.ROTORFLIGHT:
            throttle = _ends(counts / THROTTLE_COUNTS)
        return Pilot(setpoint / parts, throttle, "setpoint[0..2]", level)
    target = log.matrix("axisRate", 3)
    if target is not None:
        return Pilot(target.astype(np.float64), throttle, "axisRate[0..2]", level)
    sticks = log.matrix("rcCommand", 3)
    if sticks is None:
        lacks = "neither setpoint nor rcCommand: log one of them (blackbox_disabled_mask)"
        return Pilot(throttle=throttle, lacks=lacks)
    if level.any() and not (armed & ~level).any():
        return Pilot(np.full(sticks.shape, np.nan), throttle, "rcCommand, an angle", level)
    steady = armed & ~level
    if throttle is not None:
        steady &= (throttle >= AIRBORNE) & is_stick(throttle)
    try:
        every = readings(log.header, firmware)
        told = not TELL_RATES.isdisjoint(log.headers.told)
        chosen, note = choose(every, sticks / parts, gyro, steady, log.rate_hz, told=told)
    except RatesError as error:
        return Pilot(throttle=throttle, lacks=f"no setpoint[0..3], and {ask_rates(str(error))}")
    rates = chosen.curve(sticks / parts)
    rates[level] = np.nan
    words = f"no setpoint was logged: rcCommand is flown by {chosen.name} of the header"
    return Pilot(rates, throttle, f"rcCommand by {chosen.name}", level, f"{words}{note and ', '}{note}")


def ask_rates(why: str) -> str:
    """Return a message that the rates are unknown for the reason `why`, and how a user gives them."""
    if " " not in why:
        why = f"the header has no line {why}"
    return f"{why}: tell the rates that were flown by --header NAME=VALUE ({SETTINGS})"


def _throttle(log: Log, firmware: Firmware, parts: float) -> Array | None:
    """Return the throttle stick from rcCommand[3], which spans minthrottle..maxthrottle in some firmwares."""
    counts = log.columns.get("rcCommand[3]")
    if counts is None or firmware.maker is Maker.ROTORFLIGHT:  # Rotorflight's rcCommand[3] is the collective
        return None
    low, high = throttle_range(log.header, firmware)
    us = counts / parts
    raw = (us - CHANNEL_MIN_US) / (CHANNEL_MAX_US - CHANNEL_MIN_US)
    return np.where(is_stick(raw), np.clip((us - low) / (high - low), 0.0, 1.0), raw)


def is_stick(throttle: Array) -> Flags:
    """Return for each throttle whether a stick can give it; a little beyond either end still counts."""
    return np.asarray((throttle >= -SLACK) & (throttle <= 1.0 + SLACK))


def beyond(rates: Array, most_deg_s: float = RATE_MOST_DEG_S) -> Flags:
    """Return for each row of rates (N, 3) [deg/s] whether one exceeds `most_deg_s`."""
    return np.asarray((np.abs(rates) > most_deg_s + ROUNDED_DEG_S).any(axis=1))


def _ends(throttle: Array) -> Array:
    """Limit throttles a little beyond the stick's ends to the ends; those that no stick gives stay."""
    return np.where(is_stick(throttle), np.clip(throttle, 0.0, 1.0), throttle)


def throttle_range(header: Mapping[str, str], firmware: Firmware) -> tuple[float, float]:
    """Return rcCommand[3] [us] at zero and at full stick."""
    if has_mapped_throttle(firmware):
        told = {"minthrottle": DEFAULTS["minthrottle"], "maxthrottle": CHANNEL_MAX_US}
        low, high = (
            default if (number := header_number(header, name)) is None else number
            for name, default in told.items()
        )
        if CHANNEL_MIN_US <= low < high:
            return float(low), float(high)
    return float(CHANNEL_MIN_US), float(CHANNEL_MAX_US)


def mode_flags(log: Log) -> NDArray[np.int64] | None:
    """Return the flags of modes in each row (N,); None if they are not logged."""
    flags = log.held("flightModeFlags")
    return log.held("rcModeFlags") if flags is None else flags  # INAV's since 8


def _level(log: Log, firmware: Firmware) -> Flags:
    """Return for each row (N,) whether the stick commands an angle, in ANGLE or HORIZON mode."""
    flags = mode_flags(log)
    if flags is None:
        return np.zeros(len(log), bool)
    return np.asarray((flags & (ANGLE_BITS if has_box_mask(firmware) else ANGLE_FLAGS)) != 0)


def check(
    where: str,
    rates: Array,
    throttle: Array | None,
    seconds: Array,
    first_row: int = 0,
    most_deg_s: float = RATE_MOST_DEG_S,
) -> None:
    """Raise TraceError, naming the first, for commands that no stick gives.

    where: names the log; rates (N, 3) [deg/s], throttle and seconds (N,): of rows from first_row on;
    most_deg_s: rate that is still a command.
    """
    angle: Flags = np.asarray(np.isnan(rates).any(axis=1))
    if angle.any():
        raise TraceError(
            f"{where}: {_spans(angle, seconds)} the stick commands an angle (ANGLE or HORIZON mode), "
            f"expected a rate{_mend(angle)}"
        )
    bad = beyond(rates, most_deg_s)
    if bad.any():
        row = int(bad.argmax())
        axis = int(np.abs(rates[row]).argmax())
        raise TraceError(
            f"{where}: {_named(bad, first_row, seconds)} {AXES[axis]} is asked to turn at "
            f"{rates[row, axis]:g} deg/s, expected at most {most_deg_s:g}{_mend(bad)}"
        )
    if throttle is not None and (bad := ~is_stick(throttle)).any():
        raise TraceError(
            f"{where}: {_named(bad, first_row, seconds)} the throttle is {throttle[int(bad.argmax())]:g}, "
            f"expected 0 to 1{_mend(bad)}"
        )


def _named(bad: Flags, first_row: int, seconds: Array) -> str:
    """Describe where the first such row is, and how many more there are."""
    row = int(bad.argmax())
    more = f" and {int(bad.sum()) - 1} more" if bad.sum() > 1 else ""
    return f"in row {first_row + row} ({seconds[row]:.3f} s){more}"


def _spans(bad: Flags, seconds: Array) -> str:
    """Describe the first three time spans in which a condition holds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], bad, [False])).astype(np.int8))).reshape(-1, 2)
    words = [f"{seconds[start]:.2f} to {seconds[stop - 1]:.2f} s" for start, stop in edges[:3]]
    return f"from {', '.join(words)}{' and later' if len(edges) > 3 else ''}"


def _mend(bad: Flags) -> str:
    """Return advice to leave such rows out, if there are others."""
    return "" if bad.all() else "; leave them out by --from and --to"
