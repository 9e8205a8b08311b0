"""Who forbids arming over MSP, and the motor test as the Betaflight app opens it; attempts to defeat both."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from neuroflight.flash.link import messages, records
from neuroflight.toolchain.contract import ArmingReason, Msp
from tests.firmware.host.app import App, connected

Start = Callable[..., Any]


def boot(program: Any) -> None:
    for _ in range(1300):
        program.sticks()
        program.step()


def reasons(app: App) -> set[str]:
    return set(messages.arming_reasons(records.safety(app.ask(Msp.SAFETY)).arming_flags))


def test_nothing_arms_when_one_of_two_peers_forbids_it(start: Start) -> None:
    program = start("--gyro-hz=1000")
    boot(program)
    with connected(program) as other:
        with connected(program) as app:
            app.ask(99, b"\1\0")
            other.ask(99, b"\0\0")
            program.sticks(arm=2000)
            program.step()
            assert reasons(other) >= {ArmingReason.MSP.name}
            assert not messages.status(other.ask(101)).armed
            program.sticks()
            program.step()
        # It has hung up: what it said went with it.
        for _ in range(5):
            program.sticks()
            program.step()
        assert reasons(other) == set()
        program.sticks(arm=2000)
        program.step()
        assert messages.status(other.ask(101)).armed


def test_motors_turn_by_the_apps_own_sequence_and_stop_when_it_falls_silent(start: Start) -> None:
    program = start("--gyro-hz=1000")
    boot(program)

    def step(count: int = 1) -> tuple[int, ...]:
        for _ in range(count):
            program.sticks()
            dshot = program.step()
        return tuple(dshot)

    turning = struct.pack("<8H", 1100, *[1000] * 3, *[0] * 4)
    stopped = struct.pack("<8H", *[1000] * 8)
    with connected(program) as app, connected(program) as other:
        app.ask(99, b"\1\0")
        assert app.refused(214, turning)
        app.ask(99, b"\0\1")
        assert step() == (0, 0, 0, 0)
        app.ask(214, turning)
        assert step()[0] > 0 and step()[1:] == (0, 0, 0)
        for _ in range(5):  # it polls, but no slider moves
            assert step(300)[0] > 0
            app.ask(110)
        for _ in range(2):  # another peer's requests keep nothing alive
            step(249)
            other.ask(110)
        assert step(10) == (0, 0, 0, 0)
        assert app.refused(214, turning)
        app.ask(99, b"\1\0")
        app.ask(214, stopped)
        step(600)
        app.ask(99, b"\0\1")
        app.ask(214, turning)
        assert step()[0] > 0
        app.ask(99, b"\1\0")
        assert step() == (0, 0, 0, 0)
        step(600)
        app.ask(99, b"\0\1")
        app.ask(214, turning)
        assert step()[0] > 0
    for _ in range(100):  # it hangs up
        dshot = step()
        if dshot == (0, 0, 0, 0):
            break
    assert dshot == (0, 0, 0, 0)


def test_no_test_opens_when_armed_or_the_switch_is_on(start: Start) -> None:
    program = start("--gyro-hz=1000")
    boot(program)
    program.sticks(arm=2000)
    program.step()
    with connected(program) as app:
        assert messages.status(app.ask(101)).armed
        for payload in (b"\0\1", b"\0\1"):
            assert app.refused(99, payload)
        assert app.refused(214, struct.pack("<8H", 1100, *[1000] * 7))
        assert app.refused(0x3003, b"\1\xff\1\x07")
        assert app.refused(Msp.CALIBRATE) and app.refused(208) and app.refused(Msp.SETTINGS_DEFAULT)


def test_the_gyro_is_calibrated_anew_when_asked(start: Start) -> None:
    program = start("--gyro-hz=1000")
    boot(program)
    with connected(program) as app:
        assert reasons(app) == set()
        app.ask(Msp.CALIBRATE)
        program.sticks()
        program.step()
        assert reasons(app) == {"GYRO_NOT_CALIBRATED"}
        for _ in range(1100):
            program.sticks()
            program.step()
        assert reasons(app) == set()


def test_defaults_are_stored_by_208_and_not_by_our_own_when_asked(start: Start, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    program = start(option)
    with connected(program) as app:
        before = app.settings()
        app.change(deadband_us=9)
        app.ask(250)
        app.ask(Msp.SETTINGS_DEFAULT)
        assert app.settings() == before
    program.end()
    program = start(option)
    with connected(program) as app:
        assert app.settings() == before | {"deadband_us": 9}
        app.ask(208)
    program.end()
    with connected(start(option)) as app:
        assert app.settings() == before
