"""motor: what turns one, and everything that must not, or must stop it."""

from __future__ import annotations

import pytest

from neuroflight.flash.link import requests
from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.toolchain.contract import MOTOR_TEST_MAGIC, MOTOR_TEST_TIMEOUT_MS, ArmingReason, Msp
from tests.firmware.command_line.conftest import IdleFirmware

STOPPED = [0, 0, 0, 0]
TENTH = 48 + 200  # DShot value of 1100 us
API = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION, b""))


def turn(idle: IdleFirmware, line: str = "motor 2 1100 5") -> None:
    idle.open()
    assert len(idle.tell("motor test on")) == 1
    assert idle.tell(line) == []
    assert idle.run(2) == [0, TENTH, 0, 0]


def test_one_motor_turns_for_its_time_when_the_test_was_opened(idle: IdleFirmware) -> None:
    turn(idle, "motor 2 1100 2")
    assert idle.run(1990) == [0, TENTH, 0, 0]
    assert ArmingReason.MOTOR_TEST in idle.reasons()
    assert idle.run(20) == STOPPED
    assert idle.unasked.endswith(b"stopped\r\n# ")
    assert idle.tell("motor") == ["motor 1: DShot 0, test on"] + [f"motor {n}: DShot 0" for n in (2, 3, 4)]


def test_it_turns_again_without_opening_when_it_has_stopped(idle: IdleFirmware) -> None:
    turn(idle, "motor 2 1100 1")
    idle.run(1100)
    assert idle.tell("motor 4 1500 1") == []
    assert idle.run(2) == [0, 0, 0, 48 + 1000]


@pytest.mark.parametrize("line", ["motor 1 1100 5", "motor test off\rmotor 1 1100 5"])
def test_no_motor_turns_when_the_test_was_not_opened(idle: IdleFirmware, line: str) -> None:
    idle.open()
    assert "###ERROR motor: no motor test is open" in idle.type(line)
    assert idle.run(50) == STOPPED


@pytest.mark.parametrize(
    "line",
    [
        "motor 0 1100 5",
        "motor 5 1100 5",
        "motor 1 999 5",
        "motor 1 1501 5",
        "motor 1 1100 6",
        "motor 1 1100 0",
        "motor 1 1100",
        "motor 1",
        "motor 1 1100 5 5",
        "motor one 1100 5",
        "motor 4294967297 1100 5",
        "motor test",
        "motor 1 66636 5",
        "motor -1 1100 5",
        "motor 1 1100 5s",
        "motor test on please",
        "motor test  on",
    ],
)
def test_no_motor_turns_when_the_command_is_not_what_it_takes(idle: IdleFirmware, line: str) -> None:
    idle.open()
    idle.type("motor test on")
    (said,) = idle.tell(line)
    assert said.startswith("###ERROR motor: got '")
    assert "1 to 4, 1000 to 1500 us, 1 to 5 s" in said
    assert idle.run(50) == STOPPED


@pytest.mark.parametrize(
    "data", [b"x", b"\n", b"\r", b"\x00", b"\x03", b"$", API, b"#", b"\x02", b"\t", b"\x08"]
)
def test_the_motor_stops_when_any_byte_comes(idle: IdleFirmware, data: bytes) -> None:
    idle.open()
    idle.type("motor test on")
    idle.send(b"motor 2 1100 5\r\n")  # the line's own LF is part of it
    assert idle.run(2) == [0, TENTH, 0, 0]
    idle.send(data)
    assert idle.run(2) == STOPPED
    assert idle.run(3000) == STOPPED


def test_the_motor_stops_when_the_peer_hangs_up(idle: IdleFirmware) -> None:
    turn(idle)
    idle.hang_up()
    assert idle.run(2) == STOPPED
    idle.run(2 * MOTOR_TEST_TIMEOUT_MS)
    assert idle.reasons() == ()
    idle.open()
    assert "no motor test is open" in idle.type("motor 2 1100 5")
    assert idle.run(50) == STOPPED


def test_the_motor_stops_within_the_time_out_when_the_port_is_not_served(idle: IdleFirmware) -> None:
    turn(idle)
    idle.served = False
    assert idle.run(MOTOR_TEST_TIMEOUT_MS + 10) == STOPPED
    idle.served = True
    assert idle.run(2000) == STOPPED
    assert b"'motor test on' allows it again" in idle.unasked


def test_the_motor_stops_when_the_switch_goes_on(idle: IdleFirmware) -> None:
    turn(idle)
    assert idle.run(12, arm=2000) == STOPPED
    assert idle.run(6000, arm=2000) == STOPPED
    assert not idle.armed
    assert idle.run(500) == STOPPED


def test_no_motor_turns_when_the_switch_is_on(idle: IdleFirmware) -> None:
    idle.open()
    idle.type("motor test on")
    idle.run(30, arm=2000)
    idle.type("motor 2 1100 5")
    for _ in range(20):
        assert idle.run(50, arm=2000) == STOPPED
    idle.type("motor test on\rmotor 2 1100 5")
    for _ in range(20):
        assert idle.run(50, arm=2000) == STOPPED
    assert not idle.armed


def test_the_motor_stops_when_the_receiver_is_lost(idle: IdleFirmware) -> None:
    turn(idle)
    assert idle.run(300, heard=False) == STOPPED


def test_the_test_opened_ends_when_nobody_turns_a_motor_for_a_minute(idle: IdleFirmware) -> None:
    idle.open()
    idle.type("motor test on")
    idle.wait(61)
    idle.run(2000)
    assert "no motor test is open" in idle.type("motor 1 1100 1")
    assert idle.run(20) == STOPPED


def test_the_leave_to_turn_motors_ends_with_the_session(idle: IdleFirmware) -> None:
    idle.open()
    idle.type("motor test on")
    idle.send(API)
    idle.open()
    assert "no motor test is open" in idle.type("motor 1 1100 1")
    assert idle.run(20) == STOPPED


def test_nothing_is_saved_and_nothing_restarts_while_a_motor_rests(idle: IdleFirmware) -> None:
    turn(idle)
    operations = idle.operations
    assert "###ERROR save: nothing written, the motors are armed or under test" in idle.type("save")
    assert "###ERROR faults ack: the motors are armed or under test" in idle.type("faults ack")
    assert "###ERROR no restart: the motors are armed or under test" in idle.type("exit")
    assert idle.operations == operations
    idle.run(MOTOR_TEST_TIMEOUT_MS + 20)
    assert "Rebooting" in idle.type("exit")


def test_nothing_is_written_when_msp_tests_motors_on_the_other_port(idle: IdleFirmware) -> None:
    idle.open()
    idle.ask(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
    operations = idle.operations
    assert "nothing written" in idle.type("save")
    assert idle.operations == operations
