"""The texts of STATUSTEXT: changes of a firmware's state in words, cut into packets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.board.hints import HINTS, words
from neuroflight.flash.link.messages import BatteryLevel, arming_reasons
from neuroflight.flash.link.records import Safety
from neuroflight.toolchain.contract import FallbackCause, FaultKind, FlightState, GyroHealth, StopCause

CHUNK = 50  # characters of one STATUSTEXT
TEXT_MAX = 4 * CHUNK

EMERGENCY, CRITICAL, ERROR, WARNING, INFO = (
    mavlink.MAV_SEVERITY_EMERGENCY,
    mavlink.MAV_SEVERITY_CRITICAL,
    mavlink.MAV_SEVERITY_ERROR,
    mavlink.MAV_SEVERITY_WARNING,
    mavlink.MAV_SEVERITY_INFO,
)
_STATES = {
    FlightState.FAILSAFE_HOLD: CRITICAL,
    FlightState.FAILSAFE_DROP: EMERGENCY,
    FlightState.CRASHED: EMERGENCY,
    FlightState.FAULT: EMERGENCY,
}
_LEVELS = {BatteryLevel.WARNING: WARNING, BatteryLevel.CRITICAL: CRITICAL}


@dataclass(frozen=True)
class Text:
    """A line for the ground station."""

    severity: int
    text: str


@dataclass(frozen=True)
class Condition:
    """The state of a firmware whose changes are announced."""

    safety: Safety
    armed: bool
    battery: BatteryLevel | None = None  # None: not asked yet
    fault: FaultKind | None = None  # that nobody acknowledged


def changes(before: Condition | None, now: Condition) -> Iterator[Text]:
    """Yield a text for each change; `before` is the state announced last, or None."""
    old = before.safety if before is not None else None
    safety = now.safety
    if old is None or old.state is not safety.state:
        yield Text(_STATES.get(safety.state, INFO), f"State: {words(safety.state.name)}")
    if old is not None and old.stop_cause is not safety.stop_cause is not StopCause.NONE:
        severity = INFO if safety.stop_cause is StopCause.SWITCH else EMERGENCY
        yield Text(severity, f"Motors stopped: {words(safety.stop_cause.name)}")
    if old is not None and old.fallback_cause is not safety.fallback_cause is not FallbackCause.NONE:
        severity = INFO if safety.fallback_cause is FallbackCause.SWITCH else CRITICAL
        yield Text(severity, f"PID took over: {words(safety.fallback_cause.name)}")
    if safety.refused_cause is not FallbackCause.NONE and (
        old is None or old.refused_cause is not safety.refused_cause
    ):
        cause = words(safety.refused_cause.name)
        yield Text(ERROR, f"Policy refused: {cause}; acknowledge it to fly it again")
    if safety.gyro_health is not GyroHealth.GOOD and (
        old is None or old.gyro_health is not safety.gyro_health
    ):
        yield Text(CRITICAL, f"Gyro: {words(safety.gyro_health.name)}")
    if not now.armed:
        told = old.arming_flags if old is not None and before is not None and not before.armed else 0
        yield from arming_texts(safety.arming_flags & ~told)
    if now.battery in _LEVELS and (before is None or before.battery is not now.battery):
        yield Text(_LEVELS[now.battery], f"Battery: {words(now.battery.name)}")
    if now.fault is not None and (before is None or before.fault is not now.fault):
        yield Text(ERROR, f"Fault of an earlier run: {words(now.fault.name)}")


def arming_texts(flags: int) -> Iterator[Text]:
    """Yield a text for each reason that forbids arming, with how to lift it."""
    for reason in arming_reasons(flags):
        hint = HINTS.get(reason, "")
        yield Text(WARNING, f"Not ready: {words(reason)}{': ' if hint else ''}{hint}")


def status_texts(text: Text, number: int) -> list[Any]:
    """Split `text` into STATUSTEXT messages. number: 1..65535, of this text, used if it needs several."""
    data = text.text[:TEXT_MAX].encode("ascii", "replace")
    chunks = [data[at : at + CHUNK] for at in range(0, len(data), CHUNK)] or [b""]
    several = number if len(chunks) > 1 else 0
    return [
        mavlink.MAVLink_statustext_message(text.severity, chunk, several, index)
        for index, chunk in enumerate(chunks)
    ]
