"""Rates, dead bands and PID factors are flown as after a boot, once they are changed and the motors stand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.link import requests
from neuroflight.toolchain.contract import SETTINGS, Msp
from neuroflight.toolchain.contract.frame_time_sensors import AXES
from tests.firmware.conftest import Core
from tests.firmware.host.app import App, connected
from tests.firmware.joined.ground import Ground, Request, State

INDEX = {setting.name: index for index, setting in enumerate(SETTINGS)}
PARTS = (("rate", 123.0), ("max", 450.0), ("expo", 0.25))
TERMS = (("p", 1.2), ("i", 0.0), ("d", 1.7))
TUNED = {
    **{f"{axis}_{part}": value for axis in AXES for part, value in PARTS},
    **{f"pid_{axis}_{term}": value for axis in AXES for term, value in TERMS},
    **{"deadband_us": 12, "yaw_deadband_us": 7, "rates_style": 1},
}
STEPS = 700


def change(name: str, value: float) -> Request:
    return Request(Msp.SETTING_SET, requests.setting_set(INDEX[name], value, SETTINGS[INDEX[name]].kind))


def flown(ground: Ground) -> tuple[bytes, bytes, bytes]:
    """Return rates and PID as the control path has them, and the settings that logs tell."""
    fw, ffi = ground.firmware, ground.core.ffi
    ground.run(2)
    pid = bytes(ffi.buffer(ffi.addressof(fw.control, "pid")))
    settings = bytes(ffi.buffer(ffi.addressof(ground.background, "settings")))
    return bytes(ffi.buffer(ffi.addressof(fw, "rates"))), pid, settings


def gains(ground: Ground) -> tuple[object, ...]:
    """Return rates, and the part of the PID that a flight does not change."""
    pid = ground.firmware.control.pid
    return flown(ground)[0], *map(list, (pid.p, pid.i, pid.d, pid.integral_max))


@pytest.mark.parametrize("name", [setting.name for setting in SETTINGS if setting.at_once])
def test_it_is_flown_as_after_a_boot_when_it_is_set(
    scripted: Core, ground: Ground, ready: State, name: str
) -> None:
    ground.go_back(ready)
    before, operations = flown(ground), ground.board.flash.operations
    assert ground.ask(change(name, TUNED[name]))
    after = flown(ground)
    assert after != before
    booted = Ground(scripted, **{name: TUNED[name]})
    booted.get_ready()
    assert after == flown(booted)
    assert ground.board.flash.operations == operations, "nothing is stored"
    assert ground.ask(change(name, SETTINGS[INDEX[name]].default))
    assert flown(ground)[0:2] == before[0:2]


def test_nothing_else_is_flown_before_the_next_boot(ground: Ground, ready: State) -> None:
    for setting in SETTINGS:
        ground.go_back(ready)
        before = flown(ground)
        if not setting.at_once and setting.kind in ("uint32_t", "float"):
            value = setting.low if setting.low != setting.default else setting.high
            assert ground.ask(change(setting.name, value))
            assert flown(ground) == before, setting.name


def test_nothing_changes_in_flight_nor_under_a_motor_test(ground: Ground, ready: State) -> None:
    ground.go_back(ready)
    ground.take_off()
    before = gains(ground)
    for name, value in TUNED.items():
        assert not ground.ask(change(name, value))
    ground.background.edited.pid_roll_p = 1.2  # whoever did it
    ground.run(300)
    assert ground.armed and gains(ground) == before
    ground.go_back(ready)
    before = flown(ground)
    assert ground.ask(Request(Msp.ARMING_DISABLE, b"\0\1"))
    assert ground.ask(change("pid_roll_p", 1.2))
    ground.run(300)
    assert flown(ground) == before
    assert ground.ask(Request(Msp.ARMING_DISABLE, b"\1\0"))
    ground.run(120)
    assert flown(ground) != before


def test_it_waits_for_the_end_of_a_log_whose_header_tells_what_is_flown(ground: Ground, ready: State) -> None:
    ground.go_back(ready)
    before = flown(ground)
    ground.background.blackbox.phase = 1
    ground.background.snapshot.taken = True
    assert ground.ask(change("roll_rate", 123.0))
    ground.run(300)
    assert flown(ground) == before
    ground.background.blackbox.phase = 0
    ground.run(120)
    assert flown(ground) != before
    assert not ground.background.snapshot.taken, "what a log would begin with is of before"


def test_gains_wait_for_the_filters_that_they_want(scripted: Core) -> None:
    """What is edited goes together; with the filters that are flown until the next boot it would swing."""
    slow = {"filter1_kind": 1, "filter1_hz": 60.0}
    ground = Ground(scripted, **slow)
    ground.run(100)
    before = flown(ground)
    assert ground.ask(change("pid_roll_p", 1.2))
    ground.run(300)
    assert flown(ground) == before
    assert ground.ask(change("pid_roll_p", 1.0)) and ground.ask(change("deadband_us", 5))
    assert flown(ground) != before


# --- Flown, over the app's own messages -----------------------------------------------------------------
def fly(program: Any) -> bytes:
    """Boot, arm and fly a fixed course of sticks and rates with the PID; return the motors' commands."""
    told = b""
    for _ in range(1300):
        program.sticks(pid=2000)
        program.step()
    for step in range(STEPS):
        stick = 1500 + (step % 200) - 100
        program.sticks(arm=2000, throttle=1000 if step < 50 else 1500, roll=stick, pid=2000)
        told += bytes(str(program.step((0.3, -0.2, 0.1) if step % 50 < 25 else (0.0, 0.0, 0.0))), "ascii")
    return told


def boot(start: Any, host_program: Path, flash: Path) -> Any:
    return start("--gyro-hz=1000", f"--settings={flash}", build=host_program.parent)


def tune(app: App) -> None:
    app.ask(202, app.payload(202, roll_p=45, yaw_i=180))
    app.ask(204, app.payload(204, roll_rate=20, pitch_max=90))


def test_a_flight_has_the_new_gains_at_once_the_stored_ones_after_a_boot_and_the_same_bits_once_stored(
    start: Any, host_program: Path, tmp_path: Path
) -> None:
    flash = tmp_path / "flash.bin"

    def flight(*, tuned: bool = False, stored: bool = False) -> bytes:
        program = boot(start, host_program, flash)
        if tuned:
            with connected(program) as app:
                tune(app)
                if stored:
                    app.ask(250)
        told = fly(program)
        program.end()
        return told

    built_in = flight()
    tuned = flight(tuned=True)
    assert tuned != built_in
    assert flight() == built_in, "it was not stored"
    assert flight(tuned=True, stored=True) == tuned
    assert flight() == tuned, "the same bits from the next boot on"
