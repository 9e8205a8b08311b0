"""--blackbox of the host program: flights are appended to a file; one that takes nothing ends no flight."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from sim.blackbox.log import list_logs, read_log
from sim.ports.host import HostPort
from sim.ports.port import Sample
from toolchain.contract import CHANNEL_ARM, CHANNEL_COUNT, LogEvent

GYRO_HZ, ARMED_S, END_S = 1000, 4.5, 4.9


def fly(program: Path, log: Path) -> list[list[int]]:
    """Arm and disarm; DShot values of each gyro sample."""
    port = HostPort(program, GYRO_HZ, blackbox=log)
    rng = np.random.default_rng(3)
    values = []
    try:
        for index in range(int((END_S + 0.5) * GYRO_HZ)):
            t = index / GYRO_HZ
            channels = [1500] * 4 + [1000] * (CHANNEL_COUNT - 4)
            channels[2], channels[CHANNEL_ARM] = 1000, 2000 if ARMED_S < t < END_S else 1000
            sample = Sample(
                t, rng.normal(0, 0.01, 3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 9.81])
            )
            values.append([*port.exchange(sample, channels if index % 10 == 0 else None).dshot])
    finally:
        port.close()
    return values


def test_each_flight_is_appended_when_a_file_is_named(host_program: Path, tmp_path: Path) -> None:
    path = tmp_path / "flights.bbl"
    flown = [fly(host_program, path) for _ in range(2)]
    assert len(list_logs(path)) == 2
    for number, values in enumerate(flown, 1):
        log = read_log(path, number)
        assert log.ended and log.lost == 0 and log.events[-1].kind == LogEvent.LOG_END
        rows = log.columns["loopIteration"] + log.headers.integer("nf_first_step", -1)
        motors = log.matrix("motor")
        assert motors is not None
        assert np.array_equal(motors, np.array(values)[rows])


def test_a_file_that_cannot_be_written_is_one_line(host_program: Path, tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "log.bbl"
    done = subprocess.run([host_program, f"--blackbox={path}"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1 and str(path) in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
def test_the_flight_goes_on_when_the_disk_is_full(host_program: Path, tmp_path: Path) -> None:
    full, good = fly(host_program, Path("/dev/full")), fly(host_program, tmp_path / "log.bbl")
    assert full == good
