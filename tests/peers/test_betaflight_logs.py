"""Betaflight's logs, written by its SITL: we read what orangebox reads, and every command takes them."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.blackbox.firmware import Maker
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.blackbox.units import channels
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.recorded.files import load_flight
from tests.peers.betaflight_logs import VIRTUAL, flown, flown_over_serial, save
from tests.peers.orangebox_peer import decoded

FULL_RATE = ("set blackbox_sample_rate = 1/1", "set blackbox_high_resolution = ON")
LAST_IS_A_GROUP = [  # the fields behind baroAlt, whose group then is the last of a P frame
    f"set blackbox_disable_{group} = ON" for group in ("gyro", "gyrounfilt", "acc", "attitude", "motors")
]


@pytest.fixture(scope="module")
def roll(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Trace]:
    """A log at the full rate, and the flight's trace."""
    data, trace = flown("roll", VIRTUAL, *FULL_RATE)
    return save(tmp_path_factory.mktemp("log") / "LOG00001.BFL", data), trace


@pytest.mark.slow
def test_rows_are_those_of_orangebox_and_every_command_takes_them(
    roll: tuple[Path, Trace], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One test, since each process that runs one of these flies the log anew."""
    log = read_log(roll[0])
    ours = np.stack(list(log.columns.values()), axis=1)
    theirs = decoded(roll[0], tmp_path)
    assert len(log) > 10_000 and not log.notes and log.lost == 0 and log.ended
    assert theirs["invalid"] == 0 and (theirs["rows"][:, : ours.shape[1]] == ours).all()
    assert theirs["names"].tolist()[: ours.shape[1]] == list(log.columns)
    assert [one.split()[0] for one in theirs["events"].tolist()] == ["FLIGHT_MODE", "DISARM", "LOG_END"]
    assert log.maker is Maker.BETAFLIGHT and [one.name for one in log.events] == ["mode", "disarming", "end"]
    every_command(roll[0], tmp_path, capsys)


@pytest.mark.slow
def test_axes_and_units_are_ours_when_the_twin_tells_what_flew(roll: tuple[Path, Trace]) -> None:
    path, trace = roll
    log = read_log(path)
    told = channels(log)
    assert told.gyro_unfiltered is not None and told.setpoint is not None and told.motors is not None
    # The log begins later than the trace: the rolls are laid over each other where they are fastest.
    every = round(log.rate_hz / trace.control_rate_hz)
    gyro, rate = told.gyro_unfiltered[::every], trace.gyro
    shift = int(np.abs(rate[:, 0]).argmax()) - int(np.abs(gyro[:, 0]).argmax())
    count = min(len(gyro), len(rate) - shift)
    apart = gyro[:count] - rate[shift : shift + count]
    assert np.abs(rate[:, 0]).max() > 15  # rad/s
    assert np.abs(apart).mean() < 0.02 * np.abs(rate[:, 0]).max()
    assert np.rad2deg(told.setpoint).max() == pytest.approx(720, abs=0.1)
    assert told.motors.max() == trace.motors.max() == 1.0
    assert told.idle == pytest.approx(0.055)


def every_command(log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each command takes the log without a word on stderr, and what is written holds what was read."""
    path = str(log_path)
    for words in (["list", path], ["metrics", path], ["commands", path], ["quality", path], ["decode", path]):
        assert main(["log", *words, "--json"]) == 0
        out, err = capsys.readouterr()
        assert json.loads(out) and not err
    picture, csv, npz = tmp_path / "log.png", tmp_path / "log.csv", tmp_path / "log.npz"
    assert main(["log", "plot", path, "--out", str(picture)]) == 0
    assert main(["log", "decode", path, "--csv", str(csv), "--npz", str(npz)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    log = read_log(log_path)
    written = np.loadtxt(csv, delimiter=",", skiprows=1, dtype=np.int64)
    assert (written[:, : len(log.columns)] == np.stack(list(log.columns.values()), axis=1)).all()
    with np.load(npz, allow_pickle=False) as arrays:
        assert (arrays["field/motor[3]"] == log.columns["motor[3]"]).all()
        assert json.loads(str(arrays["headers"]))["Firmware type"] == "Betaflight"


@pytest.mark.slow
def test_log_over_a_serial_port_is_whole(tmp_path: Path) -> None:
    log = read_log(save(tmp_path / "serial.bfl", flown_over_serial("pulse")))
    assert len(log) > 8000 and log.lost == 0 and not log.notes and log.stride == 4


@pytest.mark.slow
def test_frame_is_read_when_its_last_group_has_fewer_than_eight_fields(tmp_path: Path) -> None:
    """orangebox itself reads such frames wrongly."""
    data, _ = flown("pulse", VIRTUAL, *LAST_IS_A_GROUP)
    log = read_log(save(tmp_path / "group.bfl", data))
    fields = log.headers.fields["P"]
    assert fields[-1].name == "baroAlt" and fields[-1].encoding == 6
    assert len(log) > 8000 and log.lost == 0 and not log.notes


def test_its_commands_are_flown_by_our_firmware(roll: tuple[Path, Trace], reference_library: Path) -> None:
    path, trace = roll
    scenario, warnings = load_flight(str(path), seed=1, count=1)
    assert warnings == ()
    port = ReferencePort(reference_library)
    twin = Twin(load_aircraft("nf1"), rate_hz=port.gyro_rate_hz, rng=np.random.default_rng((1, 1)))
    with closing(twin), closing(port):
        again = fly(twin, port, scenario)

    def held(flight: Trace) -> list[list[int]]:
        """The setpoints [deg/s] one after the other."""
        rounded = np.rint(np.rad2deg(flight.setpoint)).astype(int)
        changes = np.append(True, (np.diff(rounded, axis=0) != 0).any(axis=1))
        asked: list[list[int]] = rounded[changes].tolist()
        return asked

    assert held(again) == held(trace) == [[0, 0, 0], [720, 0, 0], [0, 0, 0]]
    turned = [np.flatnonzero(flight.setpoint[:, 0]).size for flight in (again, trace)]  # steps of 1 ms
    assert turned[0] == pytest.approx(turned[1], abs=5)  # a frame's 4 ms, and a row
