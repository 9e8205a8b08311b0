"""`neuroflight policy train --from`: few steps, few commands, and a run whose policy is easily beaten."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx.numpy_helper import from_array, to_array

from neuroflight.cli.main import main
from neuroflight.cli.policy.train_display import Display
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from neuroflight.sim.analysis.confidence import Mean
from neuroflight.sim.control.any_policy import own_policy
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.policy.model import parse_policy, read_policy
from neuroflight.training.fitness.proof import Flown, Proof
from neuroflight.training.runs.train import Progress, train
from neuroflight.training.runs.warm import load_start, warm_config
from neuroflight.training.tasks.flight import FlightTask
from tests.refusal import refused

Capture = pytest.CaptureFixture[str]
NF1 = Path("training/policies/nf1")
FEW = ["--steps", "4000", "--set", "selection.fit=false", "algorithm.leg_steps=1000", "task=episodic"]
FEW += ["task.hold_s=0.1"]
PULL = 0.05  # of a motor's full command


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The NF1 with a ballast that nearly doubles its moments."""
    file = tmp_path_factory.mktemp("aircraft") / "mine.toml"
    ballast = (
        '\n[[part]]\nname = "ballast"\nmass_kg = 0.1\nposition_m = [0.0, 0.0, 0.0]\nyaw_rad = 0.0\n'
        "centre_of_mass_m = [0.0, 0.0, 0.05]\ninertia_kg_m2 = [5.2e-4, 4.2e-4, 6.0e-4]\n"
    )
    file.write_text((FOLDER / "nf1.toml").read_text() + ballast)
    return file


@pytest.fixture(scope="module")
def pulling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped policy's run, whose policy has been changed since: it rolls where nothing is commanded.

    So a few steps from the run's checkpoint make a better one, and the proof holds.
    """
    folder = tmp_path_factory.mktemp("run") / "nf1"
    shutil.copytree(NF1, folder)
    model = onnx.load(folder / "policy.onnx")
    (bias,) = (tensor for tensor in model.graph.initializer if tensor.name == "bias2")
    rolls = to_array(bias) + np.array([-PULL, -PULL, PULL, PULL], np.float32)
    bias.CopyFrom(from_array(rolls, bias.name))
    onnx.save(model, folder / "policy.onnx")
    return folder


@pytest.fixture(autouse=True)
def few_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty commands of the proof, in flights of 2.3 s."""
    monkeypatch.setattr("neuroflight.training.fitness.proof.COMMANDS", 20)
    monkeypatch.setattr("neuroflight.sim.analysis.holding.DRIFT_S", 0.5)
    monkeypatch.setattr(FlightTask, "__post_init__", lambda task: None)  # refuses a hover of less than 10 s
    short = FlightTask(pulses=5, idle_s=0.05, command_s=0.2, rest_s=0.1, hover_s=0.5)
    monkeypatch.setattr("neuroflight.training.fitness.proof.FLIGHT", short)


def words(aircraft: Path, source: Path | str, out: Path) -> list[str]:
    return ["policy", "train", "--aircraft", str(aircraft), "--from", str(source), "--out", str(out), *FEW]


def architecture(data: bytes) -> int:
    """The hash by which a board takes a policy into a slot."""
    return compile_policy(parse_policy(data)).plan.architecture_hash


def test_a_refined_policy_is_of_the_other_aircraft_and_fits_the_slot_of_the_old_one(
    heavy: Path, pulling: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "mine"
    assert main(words(heavy, pulling, out)) == 0
    told = capsys.readouterr().out
    assert f"neuroflight board policy swap {out / 'policy.onnx'} --other-aircraft" in told
    assert f"Proven on the file {heavy} alone" in told
    policy = read_policy(out / "policy.onnx")
    assert load_aircraft(heavy).is_meant_by(policy.aircraft_sha256)
    assert architecture((out / "policy.onnx").read_bytes()) == architecture(
        (NF1 / "policy.onnx").read_bytes()
    )
    record = json.loads((out / "training.json").read_text())
    assert record["from"]["aircraft"] == "nf1" and record["from"]["name"] == str(pulling)
    assert record["config"]["start"] == record["from"]["checkpoint_sha256"]
    assert record["config"]["algorithm"]["change_limit"] <= 0.005  # the recipe's
    proof = json.loads((out / "proof.json").read_text())
    assert proof["refused"] is None and proof["gain"]["low"] > 0.0 and proof["flights"] == 4
    assert proof["aircraft_sha256"] == load_aircraft(heavy).sha256


@pytest.mark.slow
def test_a_refinement_is_the_same_when_it_was_interrupted_and_resumed(
    heavy: Path, pulling: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, again = tmp_path / "mine", tmp_path / "again"
    assert main(words(heavy, pulling, out)) == 0

    def stop(self: Display, progress: Progress) -> None:
        if progress.steps > 2000:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Display, "progressed", stop)
        assert main(words(heavy, pulling, again)) == 130
    assert "4,000 steps are kept" in capsys.readouterr().err and not (again / "proof.json").exists()
    other = refused(capsys, [*words(heavy, "nf1-nominal", again), "--resume"])
    assert "was trained with" in other and "resume with the same configuration" in other
    assert main([*words(heavy, pulling, again), "--resume"]) == 0
    for name in ("checkpoint.pt", "policy.onnx", "proof.json"):
        assert (again / name).read_bytes() == (out / name).read_bytes(), name


def test_a_policy_that_is_no_better_is_refused_and_not_kept(tmp_path: Path, capsys: Capture) -> None:
    before = {path.name: path.read_bytes() for path in NF1.iterdir()}
    out = tmp_path / "mine"
    assert main([*words(Path("nf1"), "nf1", out), "algorithm.learning_rate=0.5", "--json"]) == 1
    told = capsys.readouterr()
    assert json.loads(told.out)["proof"]["refused"] in told.err
    assert not list(out.glob("policy.*"))  # neither the policy nor a stamp
    assert json.loads((out / "proof.json").read_text())["gain"]["low"] <= 0.0
    assert {path.name: path.read_bytes() for path in NF1.iterdir()} == before


def test_a_general_policy_is_refined_into_one_of_its_own_architecture(tmp_path: Path, heavy: Path) -> None:
    aircraft, start = load_aircraft(heavy), load_start("any")
    config = warm_config(start, aircraft, ["steps=2000", "task.length_s=0.1"])
    assert config.world.aircraft == "file" and config.world.randomization.inertia == (0.7, 1.3)
    train(aircraft, config, tmp_path, start=start)
    made = (tmp_path / "policy.onnx").read_bytes()
    assert architecture(made) == architecture(own_policy("any", aircraft))
    assert parse_policy(made).aircraft_sha256 == aircraft.sha256


def mean(low: float, high: float) -> Mean:
    return Mean(np.array((low + high) / 2), np.array(low), np.array(high), np.array(20))


@pytest.mark.parametrize(
    ("gain", "drift", "change", "told"),
    [
        ((0.9, 1.1), (0.0, 5.0), 0.0033, None),
        ((0.9, 1.1), (-9.0, -2.0), 0.003, None),
        ((-0.1, 0.3), (0.0, 0.0), 0.003, "is no better"),
        ((0.9, 1.1), (1.5, 9.5), 0.003, "drifts: 5.5 deg (1.5 to 9.5, 95 %) more in 10 s of centred sticks"),
        ((0.9, 1.1), (0.0, 0.0), 0.0034, "moves the motors more: 0.00340 after 0.00300 in 1 ms"),
    ],
)
def test_a_proof_holds_only_with_less_error_no_more_drift_and_no_more_change(
    gain: tuple[float, float],
    drift: tuple[float, float],
    change: float,
    told: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Proof, "gain", mean(*gain))
    monkeypatch.setattr(Proof, "drift", mean(*drift))
    old, new = (
        Flown(mean(mae, mae), mean(mae, mae), each, 0.0, None)  # type: ignore[arg-type]
        for mae, each in ((2.0, 0.003), (1.0, change))
    )
    refusal = Proof(load_aircraft("nf1"), old, new).refusal
    assert (refusal is None) == (told is None)
    assert told is None or (refusal is not None and refusal.startswith(told))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--from", "none"], "--from none: no checkpoint.pt there; give the folder of a run, or one of"),
        (["--from", "nf1", "--config", "nf1"], "--from takes the configuration of its run"),
        (["--from", "nf1", "--algorithm", "ppo"], "--from takes the configuration of its run"),
        (["--from", "nf1", "--set", "hidden=[8,8]"], "has another network"),
        (["--from", "nf1", "--set", "algorithm=ppo"], "only that learner goes on from another run"),
        (["--from", "nf1", "--aircraft", "hexa"], "has another network"),
    ],
)
def test_mistake_is_one_line_and_nothing_is_written(
    options: list[str], message: str, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    assert message in refused(capsys, ["policy", "train", "--out", str(out), *options])
    assert not out.exists()


def test_a_run_is_not_repeated_without_what_it_began_with(tmp_path: Path) -> None:
    aircraft, start = load_aircraft("nf1"), load_start("nf1")
    with pytest.raises(TrainingError, match="name the run that it was by --from"):
        train(aircraft, warm_config(start, aircraft, ["steps=1000"]), tmp_path)
