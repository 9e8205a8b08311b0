"""`neuroflight policy train` as a user types it."""

import json
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.cli.policy.train import Train, configuration
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from neuroflight.training.config.config_file import load_config
from tests.refusal import refused

Capture = pytest.CaptureFixture[str]

TINY = [
    "--set",
    "task=episodic",
    "task.hold_s=0.05",
    "hidden=[8,8]",
    "algorithm.aircraft=8",
    "algorithm.leg=1",
    "algorithm.horizon=16",
    "algorithm.minibatch=64",
]


def test_the_best_of_several_seeds_is_kept(tmp_path: Path, capsys: Capture) -> None:
    words = ["policy", "train", "--algorithm", "ppo", *TINY, "--steps", "128", "--seed", "4", "--seeds", "2"]
    assert main([*words, "--out", str(tmp_path), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert list(record["seeds"]) == ["4", "5"]
    chosen = {seed: entry["chosen"] for seed, entry in record["seeds"].items()}
    best = tmp_path / f"seed-{record['seed']}"
    assert record["chosen"] == chosen[str(record["seed"])]
    assert "least MAE" in record["chosen"]["rule"]
    for name in ("checkpoint.pt", "policy.onnx"):
        assert (tmp_path / name).read_bytes() == (best / name).read_bytes()
    assert record["command"] == (
        "neuroflight policy train --aircraft nf1 --algorithm ppo --steps 128 --seed 4 --seeds 2 --set "
        "task=episodic task.hold_s=0.05 'hidden=[8,8]' algorithm.aircraft=8 algorithm.leg=1 "
        "algorithm.horizon=16 algorithm.minibatch=64"
    )
    assert (tmp_path / "monitor.png").read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--out", str(tmp_path)]) == 1
    assert "already holds a checkpoint" in capsys.readouterr().err


def test_the_chosen_checkpoint_is_what_freeze_makes_of_the_file(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "run"
    words = ["policy", "train", "--algorithm", "ppo", *TINY, "checkpoint_steps=128", "--steps", "512"]
    words += ["--out", str(out)]
    assert main([*words, "--tensorboard", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert [metrics["steps"] for metrics in record["monitor"]] == [128, 256, 384, 512]
    assert record["chosen"]["steps"] in (128, 256, 384, 512)
    again = tmp_path / "again.onnx"
    assert main(["policy", "import", str(out / "checkpoint.pt"), "--out", str(again)]) == 0
    assert again.read_bytes() == (out / "policy.onnx").read_bytes()
    assert load_config(out / "training.json").seed == record["config"]["seed"]
    tags = _tensorboard(out / "tensorboard")
    assert {"train/reward", "monitor_mean/mae", "monitor_least/change", "monitor_greatest/reward"} <= tags


@pytest.mark.parametrize("name", ["mine", "gymnasium", "ppo"])
def test_an_aircraft_of_ones_own_gets_the_flying_recipe_whatever_it_is_called(
    name: str, tmp_path: Path
) -> None:
    own = tmp_path / "own.toml"
    text = (FOLDER / "nf1.toml").read_text().replace('name = "nf1"', f'name = "{name}"')
    own.write_text(text[: text.index("[battery]")] + text[text.index("[body]") :])  # what a first file lacks
    asked, aircraft = Train(aircraft=str(own), steps=1, out=tmp_path), load_aircraft(own)
    assert configuration(asked, aircraft) == load_config("nf1", ["steps=1"])


def _tensorboard(folder: Path) -> set[str]:
    """Names of the scalars in a folder's event files."""
    from tensorboard.backend.event_processing.event_accumulator import (  # type: ignore[import-untyped]
        EventAccumulator,
    )

    events = EventAccumulator(str(folder))
    events.Reload()
    return set(events.Tags()["scalars"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--config", "nothing"], "recipe"),
        (["--config", "none.toml"], "none.toml"),
        (["--set", "steps"], "KEY=VALUE"),
        (["--set", "rewards.output=1"], "rewards"),
        (["--set", "reward=nothing"], "nothing"),
        (["--set", "world.randomization.mass=[2.0, 1.0]"], "mass"),
        (["--algorithm", "ppo", "--set", "algorithm.horizon=5000"], "horizon 5000"),
        (["--set", "selection.output=2"], "selection"),
        (["--algorithm", "nothing"], "nothing"),
        (["--seeds", "0"], "0 seeds"),
        (["--resume"], "nothing to resume"),
    ],
)
def test_invalid_arguments_are_rejected_in_one_line_and_nothing_is_written(
    arguments: list[str], message: str, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    assert message in refused(capsys, ["policy", "train", "--out", str(out), *arguments])
    assert not out.exists()
