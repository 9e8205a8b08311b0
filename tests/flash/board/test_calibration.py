"""`neuroflight board calibrate`: of the host program at rest, and of a gyro that never rests."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.cli.main import main
from neuroflight.flash.board.calibration import WAIT_S, calibrate
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.msp import Decoder, Message, encode, error, reply, request
from neuroflight.toolchain.contract import ArmingReason, Msp
from neuroflight.toolchain.errors import LinkError
from tests.flash.lockstep import BOOT_SAMPLES, STICKS_DOWN, Host

Lines = Callable[[list[bytes | None]], Any]
SAFETY = request(Msp.SAFETY)
ASKED = encode(reply(request(Msp.CALIBRATE)))


def safety(reasons: int) -> bytes:
    return encode(reply(SAFETY, struct.pack("<4BI3?BhfB", 2, 0, 0, 0, reasons, 1, 1, 0, 99, 2500, 0.05, 0)))


BUSY, DONE = safety(1 << ArmingReason.GYRO_NOT_CALIBRATED), safety(1 << ArmingReason.THROTTLE_HIGH)


def test_the_command_says_so_when_the_gyro_is_calibrated(
    host: Host, capsys: pytest.CaptureFixture[str]
) -> None:
    host.fly(BOOT_SAMPLES, STICKS_DOWN)
    with host.flying(STICKS_DOWN):
        assert main(["board", "calibrate", "--port", host.port]) == 0
        assert main(["board", "calibrate", "--port", host.port, "--json"]) == 0
    line, document = capsys.readouterr().out.split("\n", 1)
    assert line == f"{host.port}: the gyro is calibrated"
    assert json.loads(document) == {"port": host.port, "calibrated": True}


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
