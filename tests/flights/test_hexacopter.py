"""The shipped policy of the hexacopter: it builds for board and host, and flies the same bits on both."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace, load_trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.contract import DSHOT_MIN
from neuroflight.training.evaluation.controllers import load_controller
from tests.conftest import BUILD, ROOT, build_beside
from tests.flights.recomputed import recomputed
from tests.flights.wiring import reversed_aircraft
from tests.sampling import sampled

MOTORS = 6
POLICY = ROOT / "training" / "policies" / "hexa" / "policy.onnx"
TURNS = Scenario(
    "turns",
    (
        Segment(0.4, (60.0, 0.0, 0.0), 0.3),
        Segment(0.4, (0.0, -60.0, 0.0), 0.5),
        Segment(0.4, (-30.0, 30.0, 40.0), 0.4),
    ),
)


@pytest.fixture(scope="module")
def built() -> Path:
    """Folder with a build of the policy for each target, beside the aircraft's PID."""
    folder = BUILD / "hexa"
    for target in ("HOST", "MATEKF722"):
        build_beside(target, POLICY, folder, pid_table(load_aircraft("hexa")))
    return folder


def test_six_motors_get_equal_dshot_values_on_host_and_library(
    built: Path, flown: Callable[..., Trace]
) -> None:
    ports = HostPort(built / "HOST" / "neuroflight"), ReferencePort(built / "HOST" / "libneuroflight.so")
    host, library = (flown(port, TURNS, aircraft="hexa") for port in ports)
    assert host.same(library)
    assert host.dshot.shape[1] == MOTORS
    assert host.dshot.min() >= DSHOT_MIN  # every motor turns at every step
    assert np.ptp(host.dshot.astype(int), axis=0).min() > 100  # and each is steered
    error = np.abs(host.setpoint - host.rate)
    settled = error.reshape(3, -1, 3)[:, 200:]  # the last 0.2 s of each command
    assert np.degrees(settled.mean()) < 10.0


def test_compares_controller_gives_the_values_that_six_motors_got(
    built: Path, flown: Callable[..., Trace]
) -> None:
    port = ReferencePort(built / "HOST" / "libneuroflight.so")
    trace = flown(port, TURNS.under_pid(), aircraft="hexa")
    assert np.array_equal(recomputed(trace, load_controller("pid", load_aircraft("hexa"))), trace.dshot)


@pytest.mark.parametrize("scenario", [TURNS, TURNS.under_pid()], ids=["policy", "pid"])
def test_six_reversed_motors_fly_when_set_so(built: Path, tmp_path: Path, scenario: Scenario) -> None:
    port = ReferencePort(built / "HOST" / "libneuroflight.so", settings={"motors_reversed": 1})
    aircraft = reversed_aircraft("hexa", tmp_path)
    rng = np.random.default_rng(1)
    twin = Twin(aircraft, rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)
    with closing(port), closing(twin):
        trace = fly(twin, port, scenario)
    error = np.abs(trace.setpoint - trace.rate).reshape(3, -1, 3)[:, 200:]  # the last 0.2 s of each command
    assert np.degrees(error.mean()) < 10.0


@pytest.mark.slow
@pytest.mark.parametrize("speed", sampled(["dshot300", "dshot600"], "dshot300"))
def test_the_command_flies_six_motors_on_the_board_at_either_speed_of_dshot(
    built: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], speed: str
) -> None:
    scenario = tmp_path / "turn.toml"
    scenario.write_text("[[segment]]\nduration_s = 0.3\nsetpoint_deg_s = [60, -40, 30]\nthrottle = 0.4\n")
    traces = []
    for firmware, target in (("emulator", "MATEKF722"), ("reference", "HOST")):
        path = tmp_path / f"{firmware}.npz"
        options = ("--aircraft", "hexa", "--build", str(built / target), "--scenario", str(scenario))
        told = ("--set", f"motor_protocol={speed}", "--battery", "0.8", "--trace", str(path), "--json")
        assert main(["fly", "--on", firmware, *options, *told]) == 0
        document = json.loads(capsys.readouterr().out)
        traces.append(load_trace(path))
        if firmware == "emulator":
            assert document["emulator"]["outcome"] == "flown, disarmed"
    board, library = traces
    assert board.dshot.shape[1] == MOTORS
    assert board.dshot.min() >= DSHOT_MIN and np.ptp(board.dshot.astype(int), axis=0).min() > 100
    assert board.same(library)


def test_the_image_with_six_motors_keeps_its_memory_budgets(built: Path) -> None:
    report = json.loads((built / "MATEKF722" / "report.json").read_text())
    assert report["pid"]["aircraft"] == report["policy"]["aircraft"] == "hexa"
    assert all(budget["used"] <= budget["size"] for budget in report["budgets"])
