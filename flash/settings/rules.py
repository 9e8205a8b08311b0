"""Rules about settings that must fit together, as far as they are known without the firmware's policy.

The firmware has the last word: it refuses to store what contradicts itself (firmware/src/storage/settings.c).
These rules tell it before anything is changed, and name both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from neuroflight.flash.settings.text import STYLE, STYLE_BETAFLIGHT, Value, shortest
from neuroflight.toolchain.contract import (
    AXES,
    FILTER_STAGES,
    GYRO_RATES_HZ,
    LOG_BAUDS,
    LOG_DIVIDERS,
    MSP_BAUDS,
    RATE_MAX_DEG_S,
    RC_RATE_DEG_S,
    RC_RATE_STEEP,
    RC_RATE_STEEPER,
    SETTINGS,
    SUPER_ROOM_MIN,
)

_GYRO_RATE = "gyro_rate_hz"
FULL_STICK_ROUNDING_DEG_S = 0.5  # of numbers that pilots know with two decimals; as in settings.c


@dataclass(frozen=True)
class Rule:
    """A condition on several settings."""

    names: tuple[str, ...]
    broken: Callable[[Mapping[str, float]], str]  # what is wrong, "" for nothing


def broken_rules(changes: Mapping[str, Value], read: Callable[[str], Value]) -> Iterator[str]:
    """Yield a message for each rule broken after `changes`; only rules about a changed setting are checked.

    read: the present value of another setting.
    """
    for rule in RULES:
        if set(changes).intersection(rule.names):
            values = {name: float(changes[name] if name in changes else read(name)) for name in rule.names}
            if broken := rule.broken(values):
                yield broken


def _one_of(name: str, allowed: tuple[int, ...]) -> Rule:
    def broken(values: Mapping[str, float]) -> str:
        if values[name] in allowed:
            return ""
        return f"setting {name} got {values[name]:g}, expected one of {', '.join(map(str, allowed))}"

    return Rule((name,), broken)


def _below(low: str, high: str) -> Rule:
    def broken(values: Mapping[str, float]) -> str:
        if values[low] < values[high]:
            return ""
        return (
            f"setting {low} would be {shortest(values[low])}, expected below {high}, "
            f"which is {shortest(values[high])}"
        )

    return Rule((low, high), broken)


def _below_half_the_gyro_rate(switch: str, hz: str) -> Rule:
    def broken(values: Mapping[str, float]) -> str:
        if values[switch] == 0 or values[hz] * 2 < values[_GYRO_RATE]:
            return ""
        return (
            f"setting {hz} would be {shortest(values[hz])} Hz, expected below half of {_GYRO_RATE}, "
            f"which is {shortest(values[_GYRO_RATE])} Hz"
        )

    return Rule((switch, hz, _GYRO_RATE), broken)


def _different(names: tuple[str, ...]) -> Rule:
    def broken(values: Mapping[str, float]) -> str:
        met: dict[float, str] = {}
        for name, value in values.items():
            if (other := met.setdefault(value, name)) != name:
                return f"settings {other} and {name} would both be {shortest(value)}, expected different ones"
        return ""

    return Rule(names, broken)


def steep_rc_rate(rate: float) -> float:
    """Return the effective RC rate of the style betaflight."""
    return rate + RC_RATE_STEEPER * max(rate - RC_RATE_STEEP, 0.0)


def _full_stick(axis: str) -> Rule:
    """Return the rule for an axis in the style betaflight, whose two numbers limit the rate together."""
    rate, top = f"{axis}_rate", f"{axis}_max"

    def broken(values: Mapping[str, float]) -> str:
        if values[STYLE] != STYLE_BETAFLIGHT:
            return ""
        full = RC_RATE_DEG_S * steep_rc_rate(values[rate]) / max(1 - values[top], SUPER_ROOM_MIN)
        if full <= RATE_MAX_DEG_S + FULL_STICK_ROUNDING_DEG_S:
            return ""
        return (
            f"settings {rate} {shortest(values[rate])} and {top} {shortest(values[top])} would ask for "
            f"{full:.0f} deg/s at full stick, expected at most {RATE_MAX_DEG_S:g}; lower one of them"
        )

    return Rule((STYLE, rate, top), broken)


RULES = (
    _one_of(_GYRO_RATE, tuple(GYRO_RATES_HZ)),
    _one_of("msp_baud", MSP_BAUDS),
    _one_of("uart3_baud", MSP_BAUDS),
    _one_of("blackbox_baud", LOG_BAUDS),
    _one_of("blackbox_divider", LOG_DIVIDERS),
    *(
        _below_half_the_gyro_rate(f"filter{stage}_kind", f"filter{stage}_hz")
        for stage in range(1, FILTER_STAGES + 1)
    ),
    _below("dynamic_notch_low_hz", "dynamic_notch_high_hz"),
    _below_half_the_gyro_rate("dynamic_notch_count", "dynamic_notch_high_hz"),
    _different(tuple(setting.name for setting in SETTINGS if setting.name.startswith("map_"))),
    _below("battery_low_v", "battery_warn_v"),
    _below("failsafe_hold_ms", "failsafe_delay_ms"),
    *(_full_stick(axis) for axis in AXES),
)
