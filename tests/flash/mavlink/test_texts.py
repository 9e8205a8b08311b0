"""What is said of changes, and how a text becomes packets."""

from __future__ import annotations

from dataclasses import replace

import pytest

from neuroflight.flash.link.messages import BatteryLevel
from neuroflight.flash.mavlink import texts
from neuroflight.flash.mavlink.texts import CHUNK, Condition, Text, changes, status_texts
from neuroflight.toolchain.contract import (
    ArmingReason,
    FallbackCause,
    FaultKind,
    FlightState,
    GyroHealth,
    StopCause,
)
from tests.flash.mavlink.test_telemetry import SAFE

CALM = Condition(SAFE, armed=False)
FLYING = Condition(replace(SAFE, state=FlightState.ARMED), armed=True)


def said(before: Condition | None, now: Condition) -> dict[str, int]:
    return {text.text: text.severity for text in changes(before, now)}


def test_nothing_is_said_when_nothing_changes() -> None:
    assert said(CALM, CALM) == {}
    assert said(FLYING, FLYING) == {}


def test_the_state_is_said_first_of_all() -> None:
    assert said(None, CALM) == {"State: disarmed": texts.INFO}


@pytest.mark.parametrize(
    ("change", "line", "severity"),
    [
        ({"state": FlightState.FAILSAFE_HOLD}, "State: failsafe hold", texts.CRITICAL),
        ({"state": FlightState.FAILSAFE_DROP}, "State: failsafe drop", texts.EMERGENCY),
        ({"stop_cause": StopCause.RECEIVER}, "Motors stopped: receiver", texts.EMERGENCY),
        ({"stop_cause": StopCause.SWITCH}, "Motors stopped: switch", texts.INFO),
        ({"fallback_cause": FallbackCause.DEADLINE}, "PID took over: deadline", texts.CRITICAL),
        (
            {"refused_cause": FallbackCause.DEADLINE},
            "Policy refused: deadline; acknowledge it to fly it again",
            texts.ERROR,
        ),
        ({"gyro_health": GyroHealth.STUCK}, "Gyro: stuck", texts.CRITICAL),
    ],
)
def test_a_change_is_said_once(change: dict[str, object], line: str, severity: int) -> None:
    changed = replace(FLYING, safety=replace(FLYING.safety, **change))  # type: ignore[arg-type]
    assert said(FLYING, changed) == {line: severity}
    assert said(changed, changed) == {}


def test_battery_and_faults_are_said_when_they_change() -> None:
    low = replace(CALM, battery=BatteryLevel.CRITICAL, fault=FaultKind.WATCHDOG)
    assert said(CALM, low) == {
        "Battery: critical": texts.CRITICAL,
        "Fault of an earlier run: watchdog": texts.ERROR,
    }
    assert said(low, low) == {}


def test_a_reason_that_is_new_is_said_with_how_to_lift_it_and_none_in_flight() -> None:
    high = 1 << ArmingReason.THROTTLE_HIGH
    both = high | 1 << ArmingReason.MSP
    first = replace(CALM, safety=replace(SAFE, arming_flags=high))
    second = replace(CALM, safety=replace(SAFE, arming_flags=both))
    assert said(CALM, first) == {"Not ready: throttle high: put the throttle down": texts.WARNING}
    assert list(said(first, second)) == [
        "Not ready: msp: a configurator holds arming: close it or disconnect it"
    ]
    assert said(FLYING, replace(FLYING, safety=replace(FLYING.safety, arming_flags=high))) == {}


def test_a_long_text_is_cut_into_chunks_of_one_number() -> None:
    line = "x" * CHUNK + "y" * CHUNK + "z"
    cut = status_texts(Text(texts.INFO, line), 7)
    assert "".join(message.text for message in cut) == line
    assert [(message.id, message.chunk_seq) for message in cut] == [(7, 0), (7, 1), (7, 2)]
    (short,) = status_texts(Text(texts.INFO, "short"), 8)
    assert (short.id, short.chunk_seq) == (0, 0)


def test_no_text_is_longer_than_its_limit_whatever_it_quotes() -> None:
    cut = status_texts(Text(texts.INFO, "ü" * 10_000), 1)
    assert len(cut) == texts.TEXT_MAX // CHUNK
    assert all(message.text == "?" * CHUNK for message in cut)
