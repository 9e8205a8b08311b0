"""`neuroflight board gateway` as a program, against the running host program; what it refuses."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.cli.main import main
from neuroflight.toolchain.contract import SETTINGS
from tests.flash.mavlink.conftest import LOOPBACK, Station
from tests.flash.peers import HostBoard
from tests.forked import Forked

WAIT_S = 10.0  # how long anything may take before the test fails
GONE = "The line to the flight controller is gone; it has 60 s to come back"
ANYWHERE = f"udp:{LOOPBACK}:14550"


def until(station: Station, done: Callable[[], Any]) -> Any:
    """The first true value of `done`, asked after each packet that comes."""
    deadline = time.monotonic() + WAIT_S
    while not (found := done()):
        assert time.monotonic() < deadline
        station.link.select(0.1)
    return found


@pytest.fixture
def station() -> Iterator[Station]:
    made = Station(255)
    yield made
    made.close()


def test_a_ground_station_sees_the_aircraft_and_its_parameters_and_a_restart_that_it_asks_for(
    reviving_host: HostBoard, station: Station
) -> None:
    reboot = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    line = reviving_host.port
    gateway = Forked("board", "gateway", "--port", line, "--mavlink", station.address)
    try:
        until(station, lambda: station.got("HEARTBEAT"))
        station.raw(bytes(range(256)) * 4)
        station.link.mav.param_request_list_send(1, 1)
        count = sum(setting.kind != "text" for setting in SETTINGS)
        until(station, lambda: len(station.got("PARAM_VALUE")) == count)
        station.command(reboot, 1)
        until(station, lambda: station.acks(reboot))
        assert station.acks(reboot) == [mavlink.MAV_RESULT_ACCEPTED]
        until(station, lambda: GONE in station.texts())
        station.forget()
        until(station, lambda: station.got("HEARTBEAT"))
        assert reviving_host.starts == 2, "a program ends there"
        station.link.mav.param_request_read_send(1, 1, b"roll_max", -1)
        until(station, lambda: station.got("PARAM_VALUE"))
        assert gateway.poll() is None
        gateway.send_signal(signal.SIGINT)
        out, errors = gateway.communicate(timeout=WAIT_S)
    finally:
        gateway.kill()
    assert (gateway.returncode, errors) == (0, "")
    assert GONE in out and out.count("Neuroflight 0.1.0, policy nf1 ") == 2
    assert f"gateway between {line} and {station.address}; Ctrl-C ends it\n" in out


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The one line of an error."""
    assert main(["board", "gateway", *words]) == 1
    output = capsys.readouterr()
    assert output.err.count("\n") == 1
    return output.err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--mavlink", "udp:192.0.2.1:14550"), "another computer"),
        (("--mavlink", "tcp:127.0.0.1:1"), "expected udp:HOST:PORT"),
        (("--mavlink", ANYWHERE, "--allow-arm"), "--allow-arm got no --offboard"),
        (("--mavlink", ANYWHERE, "--timeout", "0"), "--timeout 0, expected 0.05 to 1 s"),
        (("--mavlink", ANYWHERE, "--timeout", "nan"), "--timeout nan"),
        (("--mavlink", ANYWHERE, "--timeout", "60"), "--timeout 60, expected"),
        (("--mavlink", ANYWHERE, "--system", "0"), "--system 0, expected 1 to 255"),
        (("--mavlink", ANYWHERE) * 9, "--mavlink: 9 values, expected 1 to 8"),
    ],
)
def test_a_mistake_is_one_line_before_anything_is_opened(
    words: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert line in refused(capsys, "--port", "/dev/does-not-exist", *words)


def test_a_port_that_is_none_is_one_line(capsys: pytest.CaptureFixture[str], free_tcp_port: int) -> None:
    port = f"tcp:{LOOPBACK}:{free_tcp_port}"
    assert "nobody listens" in refused(capsys, "--port", port, "--mavlink", ANYWHERE)


def test_offboard_is_refused_at_the_start_when_the_receiver_is_not_msp(
    resting_host: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, "--port", resting_host, "--mavlink", ANYWHERE, "--offboard")
    assert "receiver_protocol is sbus" in line and "no channel was taken" in line
