"""`neuroflight board gateway` as a program, against the running host program; what it refuses."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.cli.main import main
from neuroflight.toolchain.contract import SETTINGS
from tests.flash.mavlink.conftest import LOOPBACK, Station

ROOT = Path(__file__).resolve().parents[3]
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


def test_a_ground_station_sees_the_aircraft_and_its_parameters(resting_host: str, station: Station) -> None:
    command = [sys.executable, "-m", "neuroflight.cli.main", "board", "gateway", "--port", resting_host]
    with subprocess.Popen(
        [*command, "--mavlink", station.address],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as gateway:
        try:
            until(station, lambda: station.got("HEARTBEAT"))
            station.raw(bytes(range(256)) * 4)
            station.link.mav.param_request_list_send(1, 1)
            count = sum(setting.kind != "text" for setting in SETTINGS)
            until(station, lambda: len(station.got("PARAM_VALUE")) == count)
            station.forget()
            until(station, lambda: len(station.got("HEARTBEAT")) == 2)
            assert gateway.poll() is None
        finally:
            gateway.send_signal(signal.SIGINT)
            out, errors = gateway.communicate(timeout=WAIT_S)
    assert (gateway.returncode, errors) == (0, "")
    lines = out.splitlines()
    assert lines[0].startswith("Neuroflight 0.1.0, policy nf1 ")
    assert f"gateway between {resting_host} and {station.address}; Ctrl-C ends it" in lines


@contextmanager
def host_at(program: Path, flash: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    """Start a host program with that flash and MSP port, which never gets a sample."""
    free = [f"--{name}-port=0" for name in ("state", "receiver", "power")]
    command = [str(program), f"--settings={flash}", f"--msp-port={port}", *free, "--with-parent"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        yield process
        process.terminate()


def test_the_gateway_outlives_a_restart_that_a_ground_station_asks_for(
    host_program: Path, tmp_path: Path, free_tcp_port: int, station: Station
) -> None:
    line = f"tcp:{LOOPBACK}:{free_tcp_port}"
    command = [
        sys.executable,
        "-m",
        "neuroflight.cli.main",
        "board",
        "gateway",
        "--port",
        line,
        "--mavlink",
        station.address,
    ]
    reboot = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    flash = tmp_path / "flash.bin"
    with ExitStack() as stack, host_at(host_program, flash, free_tcp_port) as host:
        gateway = stack.enter_context(
            subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        )
        stack.callback(gateway.kill)
        until(station, lambda: station.got("HEARTBEAT"))
        station.command(reboot, 1)
        until(station, lambda: station.acks(reboot))
        assert station.acks(reboot) == [mavlink.MAV_RESULT_ACCEPTED]
        until(station, lambda: GONE in station.texts())
        assert host.wait(WAIT_S) == 0, "a program ends there"
        with host_at(host_program, flash, free_tcp_port):
            station.forget()
            until(station, lambda: station.got("HEARTBEAT"))
            station.link.mav.param_request_read_send(1, 1, b"roll_max", -1)
            until(station, lambda: station.got("PARAM_VALUE"))
            assert gateway.poll() is None
            gateway.send_signal(signal.SIGINT)
            out, errors = gateway.communicate(timeout=WAIT_S)
    assert (gateway.returncode, errors) == (0, "")
    assert GONE in out and out.count("Neuroflight 0.1.0") == 2


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
        (("--mavlink", ANYWHERE, "--timeout", "0"), "--timeout got 0"),
        (("--mavlink", ANYWHERE, "--timeout", "nan"), "--timeout got nan"),
        (("--mavlink", ANYWHERE, "--timeout", "60"), "--timeout got 60"),
        (("--mavlink", ANYWHERE, "--system", "0"), "--system got 0"),
        (("--mavlink", ANYWHERE) * 9, "9 peers"),
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
