"""--blackbox of the host program: flights go to a file, those of the run come back; a full disk ends none."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.logs.catalogue import Wait, read_entries, read_info
from neuroflight.flash.logs.messages import LogEntry, entry_request, erase_request, read_request
from neuroflight.flash.logs.reading import read_bytes
from neuroflight.sim.blackbox.log import list_logs, read_log
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.port import Sample
from neuroflight.toolchain.contract import (
    CHANNEL_ARM,
    CHANNEL_COUNT,
    LogError,
    LogEvent,
    LogState,
    Msp,
    Refusal,
)

GYRO_HZ, ARMED_S, END_S = 1000, 4.5, 4.9
PERIOD_S = 1.0  # from one flight of a run to the next
LISTED = 64  # logs of a run
START = b"H Product:"  # of every log, and nowhere else in one


def fly(program: Path, log: Path) -> list[list[int]]:
    """Arm and disarm; DShot values of each gyro sample."""
    port = HostPort(program, GYRO_HZ, blackbox=log)
    try:
        return fly_with(port, 1)
    finally:
        port.close()


def fly_with(port: HostPort, flights: int) -> list[list[int]]:
    """Arm and disarm so many times; DShot values of each gyro sample."""
    rng = np.random.default_rng(3)
    values = []
    for index in range(int((END_S + (flights - 1) * PERIOD_S + 0.5) * GYRO_HZ)):
        t = index / GYRO_HZ
        channels = [1500] * 4 + [1000] * (CHANNEL_COUNT - 4)
        armed = t > ARMED_S and (t - ARMED_S) % PERIOD_S < END_S - ARMED_S
        channels[2], channels[CHANNEL_ARM] = 1000, 2000 if armed else 1000
        sample = Sample(
            t, rng.normal(0, 0.01, 3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 9.81])
        )
        values.append([*port.exchange(sample, channels if index % 10 == 0 else None).dshot])
    return values


@contextmanager
def flown(program: Path, log: Path, flights: int) -> Iterator[tuple[Client, str]]:
    """A run that has flown so often, disarmed: a peer, and the name of its port."""
    port = HostPort(program, GYRO_HZ, blackbox=log)
    try:
        fly_with(port, flights)
        name = f"tcp:127.0.0.1:{port.msp_port}"
        with Client(open_transport(name)) as client:
            yield client, name
    finally:
        port.close()


def entries(client: Client) -> list[LogEntry]:
    return read_entries(client, read_info(client), Wait(time.monotonic, time.sleep))


def logs_of(data: bytes) -> list[bytes]:
    """The logs of a file, one behind the other."""
    head, *logs = data.split(START)
    assert head == b""
    return [START + log for log in logs]


def refusal(client: Client, command: Msp, payload: bytes) -> Refusal | None:
    with pytest.raises(RefusedError) as error:
        client.request(command, payload)
    return error.value.reason


def test_each_flight_is_appended_when_a_file_is_named(host_program: Path, tmp_path: Path) -> None:
    path = tmp_path / "flights.bbl"
    flights = [fly(host_program, path) for _ in range(2)]
    assert len(list_logs(path)) == 2
    for number, values in enumerate(flights, 1):
        log = read_log(path, number)
        assert log.ended and log.lost == 0 and log.events[-1].kind == LogEvent.LOG_END
        rows = log.columns["loopIteration"] + log.headers.integer("nf_first_step", -1)
        motors = log.matrix("motor")
        assert motors is not None
        assert np.array_equal(motors, np.array(values)[rows])


def test_the_logs_of_a_run_can_be_fetched(
    host_program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "flights.bbl", tmp_path / "out"
    old = START + b"an older run's\n"
    path.write_bytes(old)
    with flown(host_program, path, 2) as (client, port):
        first, second = logs_of(path.read_bytes().removeprefix(old))
        assert len(first) > 1000 and first != second
        found = entries(client)
        assert found == [
            LogEntry(0, "LOG00001.BBL", len(first)),
            LogEntry(1, "LOG00002.BBL", len(second)),
        ]
        for entry, log in zip(found, (first, second), strict=True):
            assert read_bytes(client, entry.index, 0, entry.bytes, time.monotonic) == log
        assert (
            client.request(Msp.LOG_READ, read_request(0, len(first), 10))
            == b"\0\0" + len(first).to_bytes(4, "little") + b"\0"
        )
        assert refusal(client, Msp.LOG_ENTRY, entry_request(2)) is Refusal.INDEX
        assert refusal(client, Msp.LOG_ERASE, erase_request()) is Refusal.ABSENT
        assert main(["board", "logs", "fetch", "--port", port, "--all", "--out", str(out)]) == 0
        assert "LOG00002.BBL" in capsys.readouterr().out
        fetched = {file.name: file.read_bytes() for file in out.iterdir()}
        assert fetched == {"LOG00001.BBL": first, "LOG00002.BBL": second}

        os.truncate(path, len(old) + len(first))  # somebody empties it meanwhile
        assert refusal(client, Msp.LOG_READ, read_request(1, 0, 10)) is Refusal.LOG
        assert read_info(client).error is LogError.READ
        assert read_bytes(client, 0, 0, len(first), time.monotonic) == first
    assert path.read_bytes() == old + first


@pytest.mark.slow
def test_more_logs_than_are_listed_leave_those_that_are(host_program: Path, tmp_path: Path) -> None:
    path = tmp_path / "flights.bbl"
    with flown(host_program, path, LISTED + 2) as (client, _):
        logs = logs_of(path.read_bytes())
        assert len(logs) == LISTED + 2
        found = entries(client)
        assert [entry.bytes for entry in found] == [len(log) for log in logs[:LISTED]]
        assert found[-1].name == f"LOG{LISTED:05}.BBL"
        assert read_bytes(client, LISTED - 1, 0, found[-1].bytes, time.monotonic) == logs[LISTED - 1]


def test_a_pipe_takes_logs_and_gives_none(host_program: Path, tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        port = HostPort(host_program, GYRO_HZ, blackbox=path)
        try:
            with Client(open_transport(f"tcp:127.0.0.1:{port.msp_port}")) as client:
                info = read_info(client)
                assert (info.state, info.logs) == (LogState.READY, 0)
                assert refusal(client, Msp.LOG_ENTRY, entry_request(0)) is Refusal.ABSENT
        finally:
            port.close()
    finally:
        os.close(reader)


def test_a_file_that_cannot_be_written_is_one_line(host_program: Path, tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "log.bbl"
    done = subprocess.run([host_program, f"--blackbox={path}"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1 and str(path) in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
def test_the_flight_goes_on_when_the_disk_is_full(host_program: Path, tmp_path: Path) -> None:
    full, good = fly(host_program, Path("/dev/full")), fly(host_program, tmp_path / "log.bbl")
    assert full == good
