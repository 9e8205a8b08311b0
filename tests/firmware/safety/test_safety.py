"""safety.c: every cell of the transition table against the rules in words; each forbidding reason by name."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest

from neuroflight.toolchain.contract import ArmingReason, FlightState, StopCause

INPUTS = {
    "on": "SAFETY_SWITCH_ON",
    "off_heard": "SAFETY_OFF_HEARD",
    "held": "SAFETY_RECEIVER_HELD",
    "invalid": "SAFETY_GYRO_INVALID",
    "stuck": "SAFETY_GYRO_STUCK",
    "saturated": "SAFETY_GYRO_SATURATED",
    "silent": "SAFETY_GYRO_SILENT",
    "crash": "SAFETY_CRASH",
    "runaway": "SAFETY_RUNAWAY",
    "no_controller": "SAFETY_NO_CONTROLLER",
}
REASONS = {
    "lost": 1 << ArmingReason.RECEIVER_LOST,
    "uncalibrated": 1 << ArmingReason.GYRO_NOT_CALIBRATED,
    "forbidden": 1 << ArmingReason.THROTTLE_HIGH,  # one that stands for all that only forbid
}
GYRO = {
    "invalid": (FlightState.FAULT, StopCause.GYRO_INVALID),
    "stuck": (FlightState.FAULT, StopCause.GYRO_STUCK),
    "silent": (FlightState.FAULT, StopCause.GYRO_SILENT),
    "saturated": (FlightState.CRASHED, StopCause.GYRO_SATURATED),
}
OWN = (ArmingReason.SWITCH_NOT_CYCLED, ArmingReason.CRASHED)
# Whatever bit: one that no reason has yet forbids, too.
FORBIDDING = [bit for bit in range(32) if bit not in OWN]
TURNING = {FlightState.ARMED, FlightState.FAILSAFE_HOLD}


def named(bit: int) -> str:
    return ArmingReason(bit).name if bit in list(ArmingReason) else f"reason {bit}"


def told(core: Any, *names: str, reasons: int = 0) -> Any:
    """The conditions that have these names, and these reasons."""
    inputs = sum(getattr(core.lib, INPUTS[name]) for name in names if name in INPUTS)
    reasons |= sum(REASONS[name] for name in names if name in REASONS)
    return core.new("struct safety_conditions *", {"reasons": reasons, "inputs": inputs})[0]


def new(core: Any, *, descend_ms: int = 0, rate_hz: int = 1000) -> Any:
    """A safety that drops, or descends for so long."""
    settings = core.new("struct nf_settings *")
    core.lib.settings_default(settings)
    settings.failsafe_stage = 1 if descend_ms else 0
    settings.failsafe_descend_ms = descend_ms
    safety = core.new("struct safety *")
    core.lib.safety_init(safety, settings, rate_hz)
    return safety


def put(core: Any, state: FlightState, ready: bool, descending: bool) -> Any:
    safety = new(core, descend_ms=3000)
    safety.state, safety.ready = state, ready
    safety.descent_left = 3000 if descending else 0
    return safety


class Cell:
    """One look from one state under one set of conditions."""

    def __init__(self, core: Any, state: FlightState, ready: bool, descending: bool, held: set[str]) -> None:
        safety = put(core, state, ready, descending)
        self.state, self.ready, self.descending, self.holds = state, ready, descending, held
        self.turning = state in TURNING or (state is FlightState.FAILSAFE_DROP and descending)
        conditions = told(core, *held)
        self.told = bool(core.lib.safety_update(safety, conditions))
        self.after, self.ready_after = FlightState(safety.state), bool(safety.ready)
        self.cause = StopCause(safety.stop_cause)
        self.motors = bool(core.lib.safety_motors(safety))
        self.shown = core.lib.safety_reasons(safety, conditions.reasons)

    def expected(self) -> tuple[FlightState, StopCause]:
        """The rules in words, read from the top: state and the cause that is new, if one is."""
        holds, state = self.holds, self.state
        lost, on = "lost" in holds, "on" in holds
        if self.turning:
            for name, stop in GYRO.items():
                if name in holds:
                    return stop
            for name, to, cause in (
                ("no_controller", FlightState.DISARMED, StopCause.NO_CONTROLLER),
                ("crash", FlightState.CRASHED, StopCause.CRASH),
                ("runaway", FlightState.CRASHED, StopCause.RUNAWAY),
            ):
                if name in holds:
                    return to, cause
        match state:
            case FlightState.ARMED | FlightState.FAILSAFE_HOLD:
                if lost:
                    return FlightState.FAILSAFE_DROP, StopCause.RECEIVER
                if not on:
                    return FlightState.DISARMED, StopCause.SWITCH
                return (FlightState.FAILSAFE_HOLD if "held" in holds else FlightState.ARMED), StopCause.NONE
            case FlightState.FAILSAFE_DROP:
                if self.descending and "off_heard" in holds:
                    return FlightState.DISARMED, StopCause.SWITCH
                return (state if on or lost else FlightState.DISARMED), StopCause.NONE
            case FlightState.CRASHED:
                return (state if on or lost else FlightState.DISARMED), StopCause.NONE
            case FlightState.BOOT:
                return FlightState.CALIBRATING, StopCause.NONE
            case FlightState.CALIBRATING:
                return (state if "uncalibrated" in holds else FlightState.DISARMED), StopCause.NONE
            case FlightState.DISARMED:
                if "uncalibrated" in holds:
                    return FlightState.CALIBRATING, StopCause.NONE
                forbidden = holds & {"lost", "forbidden"}
                return (FlightState.ARMED if self.ready and on and not forbidden else state), StopCause.NONE
            case _:
                return state, StopCause.NONE


@pytest.fixture(scope="module")
def cells(scripted: Any) -> list[Cell]:
    """All of them: each state, ready or not, descending or not, each combination of conditions."""
    names = [*INPUTS, *REASONS]
    return [
        Cell(scripted, state, ready, descending, {name for name, on in zip(names, bits, strict=True) if on})
        for state in FlightState
        for ready in (False, True)
        for descending in ((False, True) if state is FlightState.FAILSAFE_DROP else (False,))
        for bits in product((False, True), repeat=len(names))
    ]


def test_each_cell_of_the_table_is_the_rules_when_read_from_the_top(cells: list[Cell]) -> None:
    assert len(cells) == (2 * len(FlightState) + 2) << len(INPUTS) + len(REASONS)
    for cell in cells:
        assert (cell.after, cell.cause) == cell.expected(), (cell.state, cell.holds)


def test_motors_start_only_when_a_witnessed_off_turns_on_and_nothing_forbids_it(cells: list[Cell]) -> None:
    started = [cell for cell in cells if cell.motors and not cell.turning]
    assert started
    for cell in started:
        assert cell.state is FlightState.DISARMED
        assert cell.ready and "on" in cell.holds
        assert not cell.holds & set(REASONS)
    assert {cell.told for cell in started} == {True}
    assert not any(cell.told for cell in cells if cell.turning or not cell.motors)


def test_readiness_is_a_living_receiver_that_shows_the_switch_off_when_looked_at(cells: list[Cell]) -> None:
    for cell in cells:
        assert cell.ready_after == (not cell.holds & {"on", "lost"})


def test_reasons_are_shown_when_and_only_when_the_motors_stand(cells: list[Cell]) -> None:
    for cell in cells:
        reasons = sum(REASONS[name] for name in cell.holds & set(REASONS))
        if not cell.ready_after:
            reasons |= 1 << ArmingReason.SWITCH_NOT_CYCLED
        if cell.after is FlightState.CRASHED:
            reasons |= 1 << ArmingReason.CRASHED
        if cell.after is FlightState.FAULT:
            reasons |= 1 << ArmingReason.FAULT
        assert cell.shown == (0 if cell.motors else reasons)


@pytest.mark.parametrize("reason", FORBIDDING, ids=named)
def test_it_does_not_arm_and_says_why_when_one_reason_forbids_it(scripted: Any, reason: int) -> None:
    safety = put(scripted, FlightState.DISARMED, True, False)
    assert not scripted.lib.safety_update(safety, told(scripted, "on", reasons=1 << reason))
    assert not scripted.lib.safety_motors(safety)
    shown = scripted.lib.safety_reasons(safety, 1 << reason)
    assert shown == 1 << reason | 1 << ArmingReason.SWITCH_NOT_CYCLED, "the switch came too early: cycle it"
    assert not scripted.lib.safety_update(safety, told(scripted, "on")), (
        "and it does not arm when the reason goes away"
    )
    assert not scripted.lib.safety_update(safety, told(scripted))
    assert scripted.lib.safety_update(safety, told(scripted, "on"))


@pytest.mark.parametrize("reason", FORBIDDING, ids=named)
def test_it_flies_on_when_a_reason_to_forbid_arming_comes_up_in_flight(scripted: Any, reason: int) -> None:
    safety = new(scripted)
    safety.state = FlightState.ARMED
    scripted.lib.safety_update(safety, told(scripted, "on", reasons=1 << reason))
    assert scripted.lib.safety_motors(safety) == (reason != ArmingReason.RECEIVER_LOST)


def test_it_starts_in_boot_and_never_arms_when_the_switch_is_on_from_the_beginning(scripted: Any) -> None:
    safety = new(scripted)
    assert (safety.state, safety.stop_cause) == (FlightState.BOOT, StopCause.NONE)
    for _ in range(100):
        assert not scripted.lib.safety_update(safety, told(scripted, "on"))
    assert safety.state == FlightState.DISARMED


def states(core: Any, safety: Any, names: tuple[str, ...], steps: int) -> Iterator[tuple[bool, bool]]:
    """Whether motors may turn and it descends, at each of so many control steps under these conditions."""
    for _ in range(steps):
        core.lib.safety_tick(safety)
        core.lib.safety_update(safety, told(core, *names))
        yield bool(core.lib.safety_motors(safety)), bool(core.lib.safety_descending(safety))


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_it_descends_for_the_set_time_and_then_stops_when_the_receiver_is_lost(
    scripted: Any, rate_hz: int
) -> None:
    safety = new(scripted, descend_ms=50, rate_hz=rate_hz)
    safety.state = FlightState.ARMED
    steps = 50 * rate_hz // 1000
    seen = list(states(scripted, safety, ("lost",), steps + 20))
    assert seen == [(True, True)] * steps + [(False, False)] * 20
    assert safety.state == FlightState.FAILSAFE_DROP
    assert safety.stop_cause == StopCause.RECEIVER


def test_it_drops_at_once_when_no_descent_is_set(scripted: Any) -> None:
    safety = new(scripted)
    safety.state = FlightState.ARMED
    assert set(states(scripted, safety, ("lost",), 20)) == {(False, False)}


def test_a_descent_goes_on_when_the_link_comes_back_with_the_switch_on(scripted: Any) -> None:
    safety = new(scripted, descend_ms=50)
    safety.state = FlightState.ARMED
    assert list(states(scripted, safety, ("lost",), 10)) == [(True, True)] * 10
    assert list(states(scripted, safety, ("on",), 60)) == [(True, True)] * 40 + [(False, False)] * 20
    assert list(states(scripted, safety, (), 1)) == [(False, False)]
    assert safety.state == FlightState.DISARMED


def test_the_last_cause_stands_when_it_is_armed_again_and_flies(scripted: Any) -> None:
    safety = put(scripted, FlightState.ARMED, False, False)
    scripted.lib.safety_update(safety, told(scripted, "on", "runaway"))
    for names in ((), (), ("on",)):
        scripted.lib.safety_update(safety, told(scripted, *names))
    assert safety.state == FlightState.ARMED
    assert safety.stop_cause == StopCause.RUNAWAY
