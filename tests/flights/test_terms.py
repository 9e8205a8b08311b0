"""A policy with low-passed and delayed observations, an idle and a squashed output, from freeze to flight."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.cli.main import main
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.policy.model import read_policy
from tests.conftest import build_kept
from tests.flights.random_policy import frozen

Flown = Callable[..., Trace]
ROOT = Path(__file__).resolve().parents[2]
IDLE = 0.23
GYRO_HZ = 1000
TERMS = (
    "rate_error,rate_error_integral,rate,rate~15Hz,rate_error_delta~80Hz@1,"
    "previous_action~40Hz@2,throttle@16,throttle~5Hz,rate_error@1"
)
REPORT = (
    '{"policy": {"network": "19-16-4 tanh", "sha256": "", "file": "", "aircraft": "nf1", '
    '"aircraft_sha256": "", "idle": %g, "mix": "attitude-first"}, '
    '"pid": null, "files": []}'
)
BUSY = Scenario(
    "busy",
    tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(5)),
)


class Recorder(PolicyController):
    """A policy's controller that keeps its outputs."""

    def __init__(self, policy: Path) -> None:
        super().__init__(read_policy(policy))
        self.outputs: list[NDArray[np.float32]] = []

    def step(
        self, setpoint: NDArray[np.float32], gyro: NDArray[np.float32], throttle: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        self.outputs.append(super().step(setpoint, gyro, throttle))
        return self.outputs[-1]


@pytest.fixture(scope="module")
def folder() -> Path:
    """The host's build around a policy of such terms."""
    return build_kept("HOST", frozen(TERMS, IDLE), "terms")


@pytest.fixture(scope="module")
def policy(folder: Path) -> Path:
    return folder.with_name("policy.onnx")


def test_python_library_and_program_fly_the_same_bits_when_terms_have_memory(
    policy: Path, folder: Path, flown: Flown
) -> None:
    controller = Recorder(policy)
    in_python = flown(ControllerPort(controller, 4, GYRO_HZ, idle=IDLE), BUSY)
    assert flown(ReferencePort(folder / "libneuroflight.so", GYRO_HZ), BUSY).same(in_python)
    assert flown(HostPort(folder / "neuroflight", GYRO_HZ), BUSY).same(in_python)
    assert len(np.unique(np.array(controller.outputs), axis=0)) > 400, "the policy must have moved"
    assert in_python.motors.min() >= IDLE - 0.5 / 1999


def test_fly_reports_the_policys_own_output_when_it_has_an_idle(
    policy: Path, folder: Path, flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "steps.toml"
    segments = [(120, -80, 40, 0.3), (-200, 60, 0, 0.0), (0, 0, 0, 0.6)]
    scenario.write_text(
        "".join(
            f"[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = [{a}, {b}, {c}]\nthrottle = {throttle}\n"
            for a, b, c, throttle in segments
        )
    )
    arguments = ["--scenario", str(scenario), "--build", str(folder), "--gyro-hz", str(GYRO_HZ), "--json"]
    assert main(["fly", "--on", "reference", *arguments]) == 0
    effort = json.loads(capsys.readouterr().out)["flights"]["firmware"]["effort"]
    controller = Recorder(policy)
    steps = tuple(Segment(0.1, (a, b, c), throttle) for a, b, c, throttle in segments)
    flown(ControllerPort(controller, 4, GYRO_HZ, idle=IDLE), Scenario("steps", steps))
    y = np.concatenate(controller.outputs).astype(float)
    assert effort["output"] == pytest.approx(y.mean(), abs=1e-4)  # DShot's rounding
    assert effort["change"] == pytest.approx(np.abs(np.diff(y, axis=0)).mean(), abs=5e-4)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (None, "cannot read"),
        ("{}", "does not tell what is inside"),
        ("[" * 100_000, "does not tell what is inside"),
        (REPORT % 0.7, "the policy's idle is 0.7, expected 0 to 0.5"),
        (REPORT % 0.1, "is the report of another build than libneuroflight.so"),
        (" " * (1 << 20) + "{}", "expected at most 1048576"),
    ],
    ids=["absent", "empty", "deep", "out of range", "of another build", "large"],
)
def test_fly_refuses_a_build_when_its_report_does_not_fit(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: str | None, words: str
) -> None:
    (tmp_path / "libneuroflight.so").write_bytes((folder / "libneuroflight.so").read_bytes())
    if damage is not None:
        (tmp_path / "report.json").write_text(damage)
    assert (
        main(["fly", "--on", "reference", "--build", str(tmp_path), "--trace", str(tmp_path / "a.npz")]) == 1
    )
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "a.npz").exists()
