"""`neuroflight board calibrate`: of the host program at rest, and of a gyro that never rests."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli.main import main
from neuroflight.flash.board.calibration import WAIT_S, calibrate
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Decoder, Message, encode, error, reply, request
from neuroflight.toolchain.contract import ArmingReason, Msp
from neuroflight.toolchain.errors import LinkError
from tests.flash.test_info import BOOT_SAMPLES, STICKS_DOWN, Host

Lines = Callable[[list[bytes | None]], Any]
SAFETY = request(Msp.SAFETY)
ASKED = encode(reply(request(Msp.CALIBRATE)))


@pytest.fixture
def host(host_program: Path) -> Iterator[Host]:
    with ExitStack() as undo:
        yield Host(host_program, undo)


def safety(reasons: int) -> bytes:
    return encode(reply(SAFETY, struct.pack("<4BI3?BhfB", 2, 0, 0, 0, reasons, 1, 1, 0, 99, 2500, 0.05, 0)))


BUSY, DONE = safety(1 << ArmingReason.GYRO_NOT_CALIBRATED), safety(1 << ArmingReason.THROTTLE_HIGH)


def test_the_command_says_so_when_the_gyro_is_calibrated(
    host: Host, capsys: pytest.CaptureFixture[str]
) -> None:
    host.fly(BOOT_SAMPLES, STICKS_DOWN)
    over = threading.Event()

    def rest() -> None:
        while not over.is_set():
            host.fly(10, STICKS_DOWN)

    time_passes = threading.Thread(target=rest)
    time_passes.start()
    try:
        assert main(["board", "calibrate", "--port", host.port]) == 0
    finally:
        over.set()
        time_passes.join()
    assert capsys.readouterr().out == f"{host.port}: the gyro is calibrated\n"


def test_it_waits_until_the_reason_is_gone(scripted_line: Lines) -> None:
    line = scripted_line([ASKED, DONE, BUSY, DONE])  # the first look comes before it has begun
    calibrate(Client(line, clock=line.clock), line.clock, lambda _: None)
    events = Decoder().feed(b"".join(line.written))
    asked = [event.command for event in events if isinstance(event, Message)]
    assert asked == [Msp.CALIBRATE, Msp.SAFETY, Msp.SAFETY, Msp.SAFETY]


def test_one_line_says_why_when_the_gyro_never_rests(scripted_line: Lines) -> None:
    line = scripted_line([ASKED, *[BUSY] * 10_000])

    def sleep(seconds: float) -> None:
        line.now += seconds

    with pytest.raises(LinkError, match=rf"not calibrated after {WAIT_S:g} s, .* keep it still"):
        calibrate(Client(line, clock=line.clock), line.clock, sleep)


def test_a_refusal_is_told_and_nothing_waited_for(scripted_line: Lines) -> None:
    line = scripted_line([encode(error(request(Msp.CALIBRATE)))])
    with pytest.raises(LinkError, match="refuses MSP CALIBRATE"):
        calibrate(Client(line, clock=line.clock), line.clock, lambda _: None)
    assert len(line.written) == 1
