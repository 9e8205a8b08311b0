"""motor: what turns one, and everything that must not, or must stop it."""

from __future__ import annotations

import pytest

from neuroflight.flash.link import requests
from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.toolchain.contract import MOTOR_TEST_MAGIC, MOTOR_TEST_TIMEOUT_MS, ArmingReason, Msp
from tests.firmware.command_line.conftest import Desk

STOPPED = [0, 0, 0, 0]
TENTH = 48 + 200  # DShot value of 1100 us
API = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION, b""))


def turn(desk: Desk, line: str = "motor 2 1100 5") -> None:
    desk.open()
    assert len(desk.tell("motor test on")) == 1
    assert desk.tell(line) == []
    assert desk.run(2) == [0, TENTH, 0, 0]


def test_one_motor_turns_for_its_time_when_the_test_was_opened(desk: Desk) -> None:
    turn(desk, "motor 2 1100 2")
    assert desk.run(1990) == [0, TENTH, 0, 0]
    assert ArmingReason.MOTOR_TEST in desk.reasons()
    assert desk.run(20) == STOPPED
    assert desk.unasked.endswith(b"stopped\r\n# ")
    assert desk.tell("motor") == ["motor 1: DShot 0, test on"] + [f"motor {n}: DShot 0" for n in (2, 3, 4)]


def test_it_turns_again_without_opening_when_it_has_stopped(desk: Desk) -> None:
    turn(desk, "motor 2 1100 1")
    desk.run(1100)
    assert desk.tell("motor 4 1500 1") == []
    assert desk.run(2) == [0, 0, 0, 48 + 1000]


@pytest.mark.parametrize("line", ["motor 1 1100 5", "motor test off\rmotor 1 1100 5"])
def test_no_motor_turns_when_the_test_was_not_opened(desk: Desk, line: str) -> None:
    desk.open()
    assert "###ERROR motor: no motor test is open" in desk.type(line)
    assert desk.run(50) == STOPPED


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
def test_no_motor_turns_when_the_command_is_not_what_it_takes(desk: Desk, line: str) -> None:
    desk.open()
    desk.type("motor test on")
    (said,) = desk.tell(line)
    assert said.startswith("###ERROR motor: got '")
    assert "1 to 4, 1000 to 1500 us, 1 to 5 s" in said
    assert desk.run(50) == STOPPED


@pytest.mark.parametrize(
    "data", [b"x", b"\n", b"\r", b"\x00", b"\x03", b"$", API, b"#", b"\x02", b"\t", b"\x08"]
)
def test_the_motor_stops_when_any_byte_comes(desk: Desk, data: bytes) -> None:
    desk.open()
    desk.type("motor test on")
    desk.send(b"motor 2 1100 5\r\n")  # the line's own LF is part of it
    assert desk.run(2) == [0, TENTH, 0, 0]
    desk.send(data)
    assert desk.run(2) == STOPPED
    assert desk.run(3000) == STOPPED


def test_the_motor_stops_when_the_peer_hangs_up(desk: Desk) -> None:
    turn(desk)
    desk.hang_up()
    assert desk.run(2) == STOPPED
    desk.run(2 * MOTOR_TEST_TIMEOUT_MS)
    assert desk.reasons() == ()
    desk.open()
    assert "no motor test is open" in desk.type("motor 2 1100 5")
    assert desk.run(50) == STOPPED


def test_the_motor_stops_within_the_time_out_when_the_port_is_not_served(desk: Desk) -> None:
    turn(desk)
    desk.served = False
    assert desk.run(MOTOR_TEST_TIMEOUT_MS + 10) == STOPPED
    desk.served = True
    assert desk.run(2000) == STOPPED
    assert b"'motor test on' allows it again" in desk.unasked


def test_the_motor_stops_when_the_switch_goes_on(desk: Desk) -> None:
    turn(desk)
    assert desk.run(12, arm=2000) == STOPPED
    assert desk.run(6000, arm=2000) == STOPPED
    assert not desk.armed
    assert desk.run(500) == STOPPED


def test_no_motor_turns_when_the_switch_is_on(desk: Desk) -> None:
    desk.open()
    desk.type("motor test on")
    desk.run(30, arm=2000)
    desk.type("motor 2 1100 5")
    for _ in range(20):
        assert desk.run(50, arm=2000) == STOPPED
    desk.type("motor test on\rmotor 2 1100 5")
    for _ in range(20):
        assert desk.run(50, arm=2000) == STOPPED
    assert not desk.armed


def test_the_motor_stops_when_the_receiver_is_lost(desk: Desk) -> None:
    turn(desk)
    assert desk.run(300, heard=False) == STOPPED


def test_the_test_opened_ends_when_nobody_turns_a_motor_for_a_minute(desk: Desk) -> None:
    desk.open()
    desk.type("motor test on")
    desk.wait(61)
    desk.run(2000)
    assert "no motor test is open" in desk.type("motor 1 1100 1")
    assert desk.run(20) == STOPPED


def test_the_leave_to_turn_motors_ends_with_the_session(desk: Desk) -> None:
    desk.open()
    desk.type("motor test on")
    desk.send(API)
    desk.open()
    assert "no motor test is open" in desk.type("motor 1 1100 1")
    assert desk.run(20) == STOPPED


def test_nothing_is_saved_and_nothing_restarts_while_a_motor_rests(desk: Desk) -> None:
    turn(desk)
    operations = desk.operations
    assert "###ERROR save: nothing written, the motors are armed or under test" in desk.type("save")
    assert "###ERROR faults ack: the motors are armed or under test" in desk.type("faults ack")
    assert "###ERROR no restart: the motors are armed or under test" in desk.type("exit")
    assert desk.operations == operations
    desk.run(MOTOR_TEST_TIMEOUT_MS + 20)
    assert "Rebooting" in desk.type("exit")


def test_nothing_is_written_when_msp_tests_motors_on_the_other_port(desk: Desk) -> None:
    desk.open()
    desk.ask(Msp.MOTOR_TEST, requests.motor_test(MOTOR_TEST_MAGIC))
    operations = desk.operations
    assert "nothing written" in desk.type("save")
    assert desk.operations == operations
