"""A log of the firmware's own: its samples and figures are the trace's to the bit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.blackbox.flight import Part, log_trace
from neuroflight.sim.blackbox.log import read_log
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import load_scenario
from neuroflight.sim.flight.trace import save_trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample, twin_settings

GYRO_HZ = 4000


class LoggedPort(ReferencePort):
    """Keeps what the firmware logs."""

    def __init__(self, library: Path) -> None:
        super().__init__(library, GYRO_HZ, twin_settings(load_aircraft("nf1")))
        self.log = bytearray()

    def exchange(self, sample: Sample, channels_us: object) -> Reply:
        """See FirmwarePort."""
        reply = super().exchange(sample, channels_us)  # type: ignore[arg-type]
        self.log += self.reference.blackbox()
        return reply


def test_samples_and_figures_of_a_log_are_the_traces(
    reference_library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port = LoggedPort(reference_library)
    scenario = load_scenario("pulse", 1, 1, None)
    rng = np.random.default_rng((1, 1))
    trace = fly(Twin(load_aircraft("nf1"), rate_hz=GYRO_HZ, mount=scenario.mount, rng=rng), port, scenario)
    path, npz = tmp_path / "LOG00001.BBL", tmp_path / "flight.npz"
    path.write_bytes(port.log)
    save_trace(npz, trace)
    log = read_log(path)
    assert log.lost == 0 and not log.frames.corrupt
    seconds = len(trace.t) / trace.control_rate_hz
    assert log_trace(log, Part(0.0, seconds)).same(trace.by_gyro())
    idle = log.header["nf_idle"].split(",")[0]
    told = []
    for file in (path, npz):
        assert main(["log", "metrics", str(file), "--to", str(seconds), "--idle", idle, "--json"]) == 0
        told.append(json.loads(capsys.readouterr().out))
    assert told[0].pop("file") != told[1].pop("file")
    assert told[0] == told[1]
    assert main(["log", "metrics", str(path), "--to", str(seconds), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["effort"] == told[1]["effort"]  # the header tells the idle
