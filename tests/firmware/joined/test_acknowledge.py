"""What a pilot in the field hears, sees and acknowledges: a logged fault, and a policy that was refused."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.board.acknowledge import Acknowledged, acknowledge
from neuroflight.flash.link.client import Client
from neuroflight.toolchain.contract import (
    CHANNEL_PITCH,
    CHANNEL_ROLL,
    CHANNEL_YAW,
    GESTURE_MS,
    FallbackCause,
    FaultKind,
    FlightState,
    Msp,
)
from neuroflight.toolchain.errors import LinkError
from tests.firmware.joined.field import Field

ROOT = Path(__file__).resolve().parents[3]
TOLD_MS = 3000  # how long a take-over has beeper and LED for itself


@pytest.fixture
def field(scripted: Any, chip: Callable[..., Any]) -> Callable[..., Field]:
    """Makes programs in the field; over the same chip they are boots of one board."""
    return lambda on=None, **kwargs: Field(scripted, chip() if on is None else on, **kwargs)


# --- A fault of an earlier run ------------------------------------------------------------------
def test_a_board_arms_again_in_the_field_when_the_pilot_acknowledges_a_watchdog_reset(
    field: Callable[..., Field],
) -> None:
    f = field(fault=FaultKind.WATCHDOG)
    f.boot()
    assert f.reasons == {"FAULT"}
    f.arm = 2000
    f.run(100)
    assert f.safety.state == FlightState.DISARMED
    f.arm = 1000
    f.run(100)
    f.gesture()
    assert f.reasons == set()
    assert f.faults.pending is None
    f.take_off()
    f.land()
    later = field(on=f.chip)
    later.boot()
    assert later.reasons == set(), "flash remembers"
    assert later.faults.boots == 2


def test_led_and_beeper_count_the_fault_when_it_is_pending(field: Callable[..., Field]) -> None:
    f = field(fault=FaultKind.WATCHDOG)
    f.boot()
    f.run(12_000)
    rounds = [text for text in f.beeps.strip(".").split("." * 1000) if text.strip(".")]
    assert {text.count(".#") + text.startswith("#") for text in rounds[1:-1]} == {int(FaultKind.WATCHDOG)}
    assert len(rounds) >= 4
    f.gesture()
    f.run(1000)
    assert "#" not in f.beeps, "nothing is the matter any more"


def test_all_faults_are_acknowledged_when_the_pilot_does_it_once(field: Callable[..., Field]) -> None:
    f = field(fault=FaultKind.WATCHDOG)
    for kind in (FaultKind.HARD, FaultKind.BROWN_OUT):
        f = field(on=f.chip, fault=kind)
    f.boot()
    assert f.reasons == {"FAULT"}
    f.gesture()
    assert f.reasons == set()


@pytest.mark.parametrize("why", ["too short", "switch on", "throttle", "no receiver", "one stick"])
def test_the_fault_stays_when_the_sticks_do_not_say_it(field: Callable[..., Field], why: str) -> None:
    f = field(fault=FaultKind.WATCHDOG)
    f.boot()
    operations = f.chip.operations
    f.sticks = {CHANNEL_YAW: 1000, CHANNEL_PITCH: 1000, CHANNEL_ROLL: 2000}
    if why == "one stick":
        f.sticks[CHANNEL_ROLL] = 1000
    f.arm = 2000 if why == "switch on" else 1000
    f.throttle = 1200 if why == "throttle" else 1000
    if why == "no receiver":
        f.run(500)
        f.heard = False
    f.run(GESTURE_MS - 200 if why == "too short" else 2 * GESTURE_MS)
    f.arm, f.throttle, f.sticks, f.heard = 1000, 1000, {}, True
    f.run(500)
    assert f.reasons == {"FAULT"}
    assert f.chip.operations == operations


def test_flash_is_not_written_when_the_gesture_is_flown(field: Callable[..., Field]) -> None:
    f = field(fault=FaultKind.WATCHDOG)
    f.boot()
    f.gesture()
    operations = f.chip.operations
    f.take_off()
    f.throttle = 1000
    f.gesture(3 * GESTURE_MS)
    assert f.chip.operations == operations


def test_the_fault_stays_when_flash_does_not_take_the_acknowledgement(field: Callable[..., Field]) -> None:
    f = field(fault=FaultKind.WATCHDOG)
    f.boot()
    f.chip.cut(0, 0, 1)
    f.gesture()
    assert f.reasons == {"FAULT"}


# --- A policy that fell back --------------------------------------------------------------------
def test_a_policy_that_fell_back_is_told_and_refused_until_the_pilot_acknowledges(
    field: Callable[..., Field],
) -> None:
    f = field()
    f.boot()
    f.take_off()
    quiet = f.beeps[-200:]
    f.fall_back()
    f.run(1000)
    assert f.safety.pid_flies
    assert f.beeps.count("#") > 300 and quiet.count("#") == 0, "the pilot hears it in flight"
    took_over = f.light
    f.run(TOLD_MS)
    f.run(2400)
    assert "#" in f.beeps and f.light[-1000:] != took_over
    f.land()
    assert f.reasons == {"POLICY_REFUSED"}
    told = f.safety
    assert (told.fallback_cause, told.refused_cause) == (FallbackCause.POLICY_OUTPUT,) * 2
    f.arm = 2000
    f.run(50)
    assert f.safety.state == FlightState.DISARMED
    f.arm, f.pid = 1000, 2000
    f.run(50)
    f.take_off()
    f.pid = 1000
    f.run(100)
    assert f.safety.pid_flies, "the switch does not give it a chance"
    f.land()
    f.gesture()
    assert f.reasons == set()
    assert f.safety.refused_cause == FallbackCause.NONE
    f.take_off()
    assert not f.safety.pid_flies


def test_a_take_over_is_told_only_while_it_flies(field: Callable[..., Field]) -> None:
    """Its flicker is dark for a slot of 50 ms, and what tells of a refused policy for two and more."""
    pause = "." * 101
    f = field()
    f.boot()
    f.take_off()
    f.fall_back()
    f.run(1000)
    assert pause not in f.light
    f.land()
    f.run(1000)
    assert f.ms < 4000 + 550 + TOLD_MS, "it would still be told in flight"
    assert pause in f.light and "#" in f.light


def test_a_refused_policy_is_told_otherwise_than_a_fault_when_disarmed(field: Callable[..., Field]) -> None:
    refused, faulted = field(), field(fault=FaultKind.WATCHDOG)
    refused.boot()
    refused.take_off()
    refused.fall_back()
    refused.land()
    faulted.boot()
    for f in (refused, faulted):
        f.run(10_000)
        assert "#" in f.beeps and "#" in f.light
    longest = [max(map(len, text.split("."))) for text in (refused.beeps, faulted.beeps)]
    assert longest[0] > 2 * longest[1]
    longest = [max(map(len, text.split("."))) for text in (refused.light, faulted.light)]
    assert longest[0] > 2 * longest[1]


def test_msp_acknowledges_both_when_asked_and_nothing_when_armed(field: Callable[..., Field]) -> None:
    f = field(fault=FaultKind.CLOCK)
    f.boot()
    f.ask(Msp.ACKNOWLEDGE)
    f.run(200)
    assert f.reasons == set()
    f.take_off()
    f.fall_back()
    with pytest.raises(LinkError, match="armed"):
        f.ask(Msp.ACKNOWLEDGE)
    f.land()
    assert f.reasons == {"POLICY_REFUSED"}
    f.ask(Msp.ACKNOWLEDGE)
    f.run(20)
    assert f.reasons == set()


def test_the_command_tells_what_it_acknowledged_when_used(field: Callable[..., Field]) -> None:
    f = field(fault=FaultKind.WATCHDOG)
    f.boot()
    known = acknowledge(Client(f))
    assert known.fault is not None
    assert (known.fault.kind, known.fault.boot, known.refused) == (FaultKind.WATCHDOG, 1, FallbackCause.NONE)
    f.run(200)
    f.take_off()
    f.fall_back()
    f.land()
    assert acknowledge(Client(f)) == Acknowledged(None, FallbackCause.POLICY_OUTPUT)
    f.run(20)
    assert acknowledge(Client(f)) == Acknowledged(None, FallbackCause.NONE)


def test_an_acknowledgement_is_void_when_the_next_step_is_armed(field: Callable[..., Field]) -> None:
    f = field()
    f.boot()
    f.take_off()
    f.fall_back()
    f.core.lib.firmware_acknowledge(f.fw)
    f.run(20)
    assert f.safety.refused_cause == FallbackCause.POLICY_OUTPUT
    f.land()
    assert f.reasons == {"POLICY_REFUSED"}, "nor is it kept for later"


# --- The record that waits for the log ----------------------------------------------------------
@pytest.fixture(scope="module")
def main_around_a_fault(scripted_build: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """main.c around a board that was reset by a fault (fault_board.c)."""
    program = tmp_path_factory.mktemp("main") / "main"
    generated = scripted_build.parent / "generated"
    includes = [f"-I{path}" for path in (ROOT / "firmware", ROOT / "firmware/src", generated)]
    sources = [str(Path(__file__).parent / "fault_board.c"), str(ROOT / "firmware/src/main.c")]
    library = ["-L", str(scripted_build), "-lneuroflight", f"-Wl,-rpath,{scripted_build}"]
    flags = ["-std=c11", "-fshort-enums", "-Werror"]
    subprocess.run(["gcc", *flags, *includes, *sources, *library, "-o", str(program)], check=True)
    return program


@pytest.mark.parametrize(
    ("how", "cleared"), [("good", True), ("flash refuses", False), ("settings refused", False)]
)
def test_the_record_of_a_fault_is_kept_when_it_did_not_come_into_the_log(
    main_around_a_fault: Path, how: str, cleared: bool
) -> None:
    done = subprocess.run([main_around_a_fault, how], capture_output=True, text=True, check=True)
    entry, kept = done.stdout.split()
    assert (entry, kept) == (("logged", "cleared") if cleared else ("unlogged", "kept"))
