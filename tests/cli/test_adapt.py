"""`neuroflight policy adapt` as a user types it: a log whose truth is known, few steps, few episodes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
from onnx.numpy_helper import from_array, to_array

import neuroflight.cli.policy.adapt
import neuroflight.training.adaptation.adapt
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.analysis.confidence import Mean
from neuroflight.sim.flight.trace import Trace, save_trace
from neuroflight.toolchain.codegen.compiler import CompiledPolicy
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.toolchain.verification.verify import Candidate, all_candidates
from neuroflight.training.adaptation.adapt import Bench, Proof
from neuroflight.training.tasks.flight import FlightTask
from tests.refusal import refused
from tests.sim.identification.test_moments import NF1, flight

Capture = pytest.CaptureFixture[str]
POLICY = Path("training/policies/nf1")
HEAVIER = np.array([1.9, 1.6, 1.4])  # times the file's moments
SMALL, FEW = ["--steps", "2000", "--episodes", "6"], ["--steps", "2000", "--episodes", "20"]
PULL = 0.05  # of a motor's full command


def save(path: Path, steps: int = 4000, spread: float = 0.1) -> Path:
    """The trace of a flight without a controller, of an aircraft whose moments are HEAVIER."""
    turn, properties = np.diag(np.sqrt(HEAVIER)), NF1.mass_properties
    heavy = replace(NF1, mass_properties=replace(properties, inertia=turn @ properties.inertia @ turn))
    flown = flight(heavy, spread)
    none, dshot = np.zeros((steps, 3), np.float32), np.full((steps, 4), 500, np.uint16)
    gyro = flown.gyro[:steps]
    trace = Trace(
        np.arange(steps) / flown.rate_hz,
        none,
        gyro.astype(np.float64),
        gyro.astype(np.float32),
        flown.motors[:steps],
        dshot,
        none[:, 0],
    )
    save_trace(path, trace)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds of it."""
    return save(tmp_path_factory.mktemp("flown") / "flight.npz")


@pytest.fixture(scope="module")
def pulling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped policy's run, whose policy has been changed since: it rolls where nothing is commanded.

    So a few steps from the run's checkpoint make a better one, and the proof holds.
    """
    folder = tmp_path_factory.mktemp("run") / "nf1"
    shutil.copytree(POLICY, folder)
    model = onnx.load(folder / "policy.onnx")
    (bias,) = (tensor for tensor in model.graph.initializer if tensor.name == "bias2")
    rolls = to_array(bias) + np.array([-PULL, -PULL, PULL, PULL], np.float32)
    bias.CopyFrom(from_array(rolls, bias.name))
    onnx.save(model, folder / "policy.onnx")
    return folder


@pytest.fixture(autouse=True)
def small_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few observations to verify with, few commands to find the motors' change with, in flights of 5.5 s."""
    monkeypatch.setattr(neuroflight.cli.policy.adapt, "VERIFIED", 8)
    monkeypatch.setattr(neuroflight.training.adaptation.adapt, "CALIBRATION", 4)
    monkeypatch.setattr("neuroflight.sim.analysis.holding.DRIFT_S", 0.5)
    monkeypatch.setattr(
        FlightTask, "__post_init__", lambda task: None
    )  # a hover of less than 10 s is refused
    short = FlightTask(pulses=5, idle_s=0.2, command_s=0.5, rest_s=0.3, hover_s=0.5)
    monkeypatch.setattr(neuroflight.training.adaptation.adapt, "FLIGHT", short)


def test_a_dry_run_tells_the_factors_and_writes_nothing(log: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "adapted"
    arguments = ["policy", "adapt", str(log), "--policy", str(POLICY), "--out", str(out), "--dry-run", *SMALL]
    assert main([*arguments, "--json"]) == 0
    factors = json.loads(capsys.readouterr().out)["factors"]
    for axis, times in zip(("roll", "pitch", "yaw"), HEAVIER, strict=True):
        assert factors[axis]["turns"] == pytest.approx(1.0 / times, rel=0.02)
        assert factors[axis]["inertia_over_thrust"] == pytest.approx(times, rel=0.02)
        assert factors[axis]["explained"] > 0.9
    assert main(arguments) == 0
    assert capsys.readouterr().out.count("times as much as the file says") == 3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_policy_that_is_not_better_is_refused_and_nothing_is_kept(
    log: Path, tmp_path: Path, capsys: Capture
) -> None:
    before = {path.name: path.read_bytes() for path in POLICY.iterdir()}
    out = tmp_path / "runs" / "adapted"
    assert (
        main(["policy", "adapt", str(log), "--policy", str(POLICY), "--out", str(out), *SMALL, "--json"]) == 1
    )
    told = capsys.readouterr()
    document = json.loads(told.out)
    assert document["refused"] in told.err and "refused, nothing was kept" in told.err
    assert told.err.count("\n") == 1
    gain = document["proof"]["adapted"]["gain"]
    assert gain["low"] <= 0.0
    assert list(out.parent.iterdir()) == []
    assert {path.name: path.read_bytes() for path in POLICY.iterdir()} == before


def mean(low: float, high: float) -> Mean:
    return Mean(np.array((low + high) / 2), np.array(low), np.array(high), np.array(20))


def test_a_policy_that_may_be_no_better_is_refused() -> None:
    old, new = (Bench(mean(each, each), 0.003, None) for each in (2.0, 1.9))  # type: ignore[arg-type]
    proof = Proof(old, new, mean(-0.1, 0.3), mean(0.0, 0.0), old, new)
    assert proof.refusal is not None and proof.refusal.startswith("is no better on the adapted aircraft")


@pytest.mark.parametrize(
    ("drift", "refused"), [((0.0, 5.0), False), ((1.5, 9.5), True), ((-9.0, -2.0), False)]
)
def test_a_policy_that_drifts_more_is_refused_though_its_error_is_smaller(
    drift: tuple[float, float], refused: bool
) -> None:
    old, new = (Bench(mean(each, each), 0.003, None) for each in (2.0, 1.0))  # type: ignore[arg-type]
    proof = Proof(old, new, mean(0.9, 1.1), mean(*drift), old, new)
    assert (proof.refusal is not None) == refused
    if refused:
        assert proof.refusal == (
            "drifts: 5.5 deg (1.5 to 9.5, 95 %) more in 10 s of centred sticks, expected at most 1"
        )


def test_a_policy_whose_proof_holds_lies_in_the_new_folder(
    log: Path, pulling: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    opened: list[bytes] = []

    def watched(
        compiled: CompiledPolicy, data: bytes, folder: Path, checkpoint: Path | None
    ) -> tuple[Candidate, ...]:
        opened.append(data)
        return all_candidates(compiled, data, folder, checkpoint)

    monkeypatch.setattr("neuroflight.toolchain.verification.verify.all_candidates", watched)
    out = tmp_path / "adapted"
    arguments = ["policy", "adapt", str(log), "--policy", str(pulling), "--out", str(out), *FEW]
    assert main(arguments) == 0
    assert f"neuroflight board policy swap {out / 'policy.onnx'}" in capsys.readouterr().out
    kept = {path.name: path.read_bytes() for path in out.iterdir()}
    assert set(kept) >= {"aircraft.toml", "policy.onnx", "adaptation.json", "training.json", "checkpoint.pt"}
    assert list(tmp_path.iterdir()) == [out]  # nothing beside it
    adapted = load_aircraft(out / "aircraft.toml")
    moments = np.diag(adapted.mass_properties.inertia) / np.diag(NF1.mass_properties.inertia)
    assert moments == pytest.approx(HEAVIER, rel=0.02)
    # The policy was trained on that file, and is another one than it began as.
    policy = read_policy(out / "policy.onnx")
    assert policy.aircraft_sha256 == adapted.sha256 != NF1.sha256
    assert opened == [kept["policy.onnx"]]
    for other in (POLICY, pulling):
        assert kept["policy.onnx"] != (other / "policy.onnx").read_bytes()
    document = json.loads(kept["adaptation.json"])
    assert document["refused"] is None and document["proof"]["flights"] == 4
    assert document["verification"] == "holds"
    assert document["proof"]["adapted"]["gain"]["low"] > 0.0
    assert document["proof"]["original"]["aircraft_sha256"] == NF1.sha256

    assert main(arguments) == 1  # once more: no policy is replaced
    assert f"--out {out}: exists" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == kept


def otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the core's policy differ."""
    finding = SimpleNamespace(finding=SimpleNamespace(message="the core differs"), verdict="differs")
    monkeypatch.setattr("neuroflight.toolchain.verification.verify.all_candidates", lambda *_: [])
    monkeypatch.setattr("neuroflight.toolchain.verification.verify.verify", lambda *_, **__: finding)


def test_a_policy_that_computes_otherwise_on_the_machines_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    otherwise(monkeypatch)
    with pytest.raises(NeuroflightError, match="refused, nothing was kept: the core differs"):
        neuroflight.cli.policy.adapt._verified(POLICY / "policy.onnx")


@pytest.mark.slow
def test_a_policy_that_computes_otherwise_on_the_machines_is_not_kept(
    log: Path, pulling: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    otherwise(monkeypatch)
    out = tmp_path / "adapted"
    assert main(["policy", "adapt", str(log), "--policy", str(pulling), "--out", str(out), *FEW]) == 1
    assert "refused, nothing was kept: the core differs" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("log_name", "options", "message"),
    [
        ("none.npz", {}, "none.npz"),
        ("flight.csv", {}, "expected a trace (.npz) or a blackbox log"),
        ("flight.txt", {}, "flight.txt: holds no log"),
        ("broken.npz", {}, "broken.npz"),
        ("short.npz", {}, "expected at least 2000; fly longer"),
        ("calm.npz", {}, "fly steps"),
        ("flight.npz", {"--policy": "none"}, "none"),
        ("flight.npz", {"--aircraft": "none.toml"}, "none.toml"),
        ("flight.npz", {"--aircraft": "hexa"}, "4 motors, the aircraft has 6"),
        ("flight.npz", {"--steps": "0"}, "--steps 0"),
        ("flight.npz", {"--episodes": "1"}, "--episodes 1"),
        ("flight.npz", {"--seed": "-1"}, "--seed -1, expected 0 or more"),
        ("flight.npz", {"--out": "flight.npz"}, "--out flight.npz: exists"),
    ],
)
def test_mistake_is_one_line_and_nothing_is_written(
    log_name: str,
    options: dict[str, str],
    message: str,
    log: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    policy = POLICY.resolve()
    monkeypatch.chdir(log.parent)
    if not Path("short.npz").exists():
        save(Path("short.npz"), steps=1500)
        save(Path("calm.npz"), spread=0.0)
        for name in ("flight.csv", "flight.txt"):
            Path(name).write_text("no log\n")
        Path("broken.npz").write_text("no trace\n")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    given = {"--policy": str(policy), "--out": "adapted", "--steps": "2000", "--episodes": "6", **options}
    assert message in refused(
        capsys, ["policy", "adapt", log_name, *(word for pair in given.items() for word in pair)]
    )
    assert {path: path.read_bytes() for path in Path().iterdir()} == before
