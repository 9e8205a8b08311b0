"""The command line of the shipped image over UART1 of the emulated board, at 115200 baud."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.toolchain.contract import SETTINGS, Msp
from neuroflight.toolchain.image.elf import read_flashable

BAUD = 115200
MILLISECOND = TIME_HZ // 1000
API = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION, b""))
API_ANSWER = b"$M>\x03\x01\x00\x01\x2f\x2c"


@pytest.fixture(scope="module")
def booted(board_image: Path) -> Iterator[tuple[IdleBoard, Snapshot]]:
    idle = IdleBoard(read_flashable(board_image.with_suffix(".bin")), elf=board_image)
    idle.run_to(TIME_HZ)
    yield idle, take_snapshot(idle.board.engine)
    idle.close()


@pytest.fixture
def talk(booted: tuple[IdleBoard, Snapshot]) -> Callable[[bytes, bytes], bytes]:
    """Sends, and returns what comes until `end` has come; a second after the boot."""
    idle, snapshot = booted
    restore_snapshot(idle.board.engine, snapshot)
    line = UartLine(idle.board, format=Format(BAUD))

    def exchange(data: bytes, end: bytes) -> bytes:
        line.send(data)
        said = b""
        for _ in range(400):
            idle.run_to(idle.board.cycle + 10 * MILLISECOND)
            said += line.take()
            if said.endswith(end):
                return said
        raise AssertionError(f"{end!r} did not come: {said[-200:]!r}")

    return exchange


PROMPT = b"\r\n# "
SCRATCH = {
    "gyro_rate_hz": "8000",
    "craft_name": '" x "',
    "roll_expo": "0.3",
    "mode7": "pid aux3 1300 1500 and",
}


@pytest.mark.slow
def test_a_pasted_dump_gives_identical_settings_at_the_speed_of_the_line(
    talk: Callable[[bytes, bytes], bytes],
) -> None:
    assert talk(b"#", PROMPT).startswith(b"\r\nNeuroflight ")
    for name, value in SCRATCH.items():
        talk(f"set {name} = {value}\r".encode(), PROMPT)
    dump = talk(b"dump\r", PROMPT).removeprefix(b"dump\r\n").removesuffix(b"# ")
    assert dump.count(b"\r\nset ") == len(SETTINGS)
    wanted = talk(b"diff\r", PROMPT)
    assert wanted.count(b"set ") == len(SCRATCH)
    assert b"not saved" in talk(b"defaults\r", PROMPT)
    assert talk(b"diff\r", PROMPT) == b"diff\r\n# "
    said = talk(dump + b"# end of it\r", b"# end of it" + PROMPT)
    assert b"ERROR" not in said
    assert talk(b"diff\r", PROMPT) == wanted


def test_msp_is_answered_after_a_session_that_nobody_left(talk: Callable[[bytes, bytes], bytes]) -> None:
    talk(b"#", PROMPT)
    talk(b"set craft_na", b"set craft_na")
    assert talk(API, API_ANSWER).endswith(API_ANSWER)
    assert talk(API, API_ANSWER) == API_ANSWER


def test_status_and_tasks_say_what_the_board_does(talk: Callable[[bytes, bytes], bytes]) -> None:
    talk(b"#", PROMPT)
    status = talk(b"status\r", PROMPT).decode()
    assert "state: " in status
    assert " CLI" in status
    tasks = talk(b"tasks\r", PROMPT).decode()
    control = next(line.split() for line in tasks.splitlines() if line.startswith("CONTROL"))
    assert control[1] == "1000"
    assert 0 < int(control[4]) < 1000, "microseconds"


def test_a_saved_setting_is_there_after_the_restart(talk: Callable[[bytes, bytes], bytes]) -> None:
    talk(b"#", PROMPT)
    talk(b"set craft_name = NF1\r", PROMPT)
    assert b"saved\r\n" in talk(b"save\r", b"Rebooting\r\n")
