"""`neuroflight policy train` and `neuroflight evaluate` as a user types them."""

import json
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER
from tests.cli.test_train import TINY
from tests.refusal import refused
from tests.sampling import sampled

Capture = pytest.CaptureFixture[str]


def test_train_writes_its_results_and_does_not_replace_them_without_force(
    tmp_path: Path, capsys: Capture
) -> None:
    arguments = ["policy", "train", "--algorithm", "ppo", *TINY, "--steps", "128", "--seed", "3"]
    arguments += ["--out", str(tmp_path)]
    assert main(arguments) == 0
    assert "128 steps" in capsys.readouterr().out
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    results = {"checkpoint.pt", "policy.onnx", "training.json"}
    assert set(made) == {*results, "monitor.json", "monitor.png", "rewards.csv"}
    assert (
        "policy train --aircraft nf1 --algorithm ppo --steps 128 --seed 3" in made["training.json"].decode()
    )
    assert main(arguments) == 1
    assert "already holds a checkpoint" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == made


@pytest.mark.parametrize("task", sampled(["pulse", "episodic", "envelope"], "episodic"))
def test_evaluate_json_names_the_conditions(task: str, tmp_path: Path, capsys: Capture) -> None:
    plot = tmp_path / "plot.png"
    words = ["evaluate", "pid:published", "--task", task, "--episodes", "3", "--seed", "8", "--no-noise"]
    assert main([*words, "--delay", "0", "--json", "--plot", str(plot)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["command"] == (
        f"neuroflight compare pid:published --aircraft nf1 --one --task {task} --episodes 3 --seed 8 "
        "--no-noise --delay 0"
    )
    assert (document["pid"], document["noise"], document["delay_s"]) == ("published", False, 0.0)
    assert document["response"]["episodes"] == 3
    assert len(document["response"]["success"]["value"]) == 3
    assert len(document["margin_95"]["mae"]) == 3
    assert plot.read_bytes().startswith(b"\x89PNG")
    if task == "episodic":  # the command gives the same once more
        assert main([*document["command"].split()[1:], "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == document


def test_evaluate_flies_better_when_nothing_delays_the_rotors(capsys: Capture) -> None:
    figures = []
    for delay in ("0", "0.02"):
        words = ["evaluate", "pid:published", "--task", "episodic", "--episodes", "5", "--no-noise"]
        assert main([*words, "--delay", delay, "--json"]) == 0
        figures.append(json.loads(capsys.readouterr().out))
    assert sum(figures[0]["mse"]) < 0.8 * sum(figures[1]["mse"])


def test_evaluate_rejects_a_policy_for_another_number_of_motors(
    shipped_policy: Path, tmp_path: Path, capsys: Capture
) -> None:
    five = tmp_path / "five.toml"
    rotor = (
        '[[rotor]]\nmotor_m = [0.2, 0.0, 0.042]\npropeller_m = [0.2, 0.0, 0.058]\nspin = "cw"\n\n[propulsion]'
    )
    text = (FOLDER / "nf1.toml").read_text().split("[pid.")[0]
    five.write_text(text.replace("[propulsion]", rotor))
    assert "drives 4 motors, aircraft nf1 has 5" in refused(
        capsys, ["compare", "--one", str(shipped_policy), "--aircraft", str(five)]
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["policy", "train", "--aircraft", "nf9", "--out", "OUT"], "nf9"),
        (["policy", "train", "--steps", "0", "--out", "OUT"], "steps 0, expected 1 to 1000000000000"),
        (["policy", "train", "--seed", "-4", "--out", "OUT"], "seed -4"),
        (["policy", "train", "--out", "FILE"], "is no folder"),
    ],
)
def test_bad_input_is_rejected_in_one_line_and_nothing_is_written(
    arguments: list[str], message: str, tmp_path: Path, capsys: Capture
) -> None:
    file = tmp_path / "file"
    file.write_text("not what you think")
    names = {"OUT": str(tmp_path / "out"), "FILE": str(file), "OUT/none.onnx": str(tmp_path / "none.onnx")}
    assert message in refused(capsys, [names.get(word, word) for word in arguments])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
