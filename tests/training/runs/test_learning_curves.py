"""Learning curves of runs whose rewards are known, and `neuroflight policy curves` as a user types it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.runs.learning_curves import curves
from neuroflight.training.runs.learning_curves_plot import draw_curves
from neuroflight.training.runs.rewards import Rewards
from neuroflight.training.tasks.task import EpisodicTask
from tests.refusal import refused

Capture = pytest.CaptureFixture[str]
STEPS = 100_000
CONFIG = TrainingConfig(steps=STEPS, task=EpisodicTask())
NF1 = load_aircraft("nf1")


def run(
    folder: Path,
    seed: int,
    reward: Callable[[float], float],
    *,
    config: TrainingConfig = CONFIG,
    points: int = 100,
) -> Path:
    """A folder as `train` leaves it; reward: of the part of the run that is over."""
    folder.mkdir(parents=True)
    document = replace(config, seed=seed).document(NF1)
    (folder / "training.json").write_text(json.dumps({"config": document, "steps": STEPS}))
    parts = [(number + 1) / points for number in range(points)]
    Rewards(tuple((round(STEPS * part), reward(part)) for part in parts)).write(folder / "rewards.csv")
    return folder


def rising(final: float) -> Callable[[float], float]:
    """From 4 below `final` to it, 95 % of the way after about 0.3 of the run."""
    return lambda part: final - 4.0 * float(np.exp(-10.0 * part))


def test_the_end_is_that_of_the_seeds_with_their_confidence(tmp_path: Path) -> None:
    for seed, final in ((1, -1.0), (2, -2.0), (3, -3.0)):
        run(tmp_path / f"seed-{seed}", seed, rising(final))
    (curve,) = curves([tmp_path], ["ppo"])
    assert [each.seed for each in curve.runs] == [1, 2, 3]
    assert float(curve.final.value) == pytest.approx(-2.0, abs=1e-3)
    assert float(curve.final.high - curve.final.value) == pytest.approx(4.303 / np.sqrt(3), rel=1e-3)
    assert curve.best.seed == 1
    assert curve.episode_steps == 1000
    # From the first point (part 0.01) on, 95 % of the way are done after -ln(0.05) / 10, smoothed over 0.05.
    assert curve.reached_steps is not None
    assert float(curve.reached_steps.value) == pytest.approx(STEPS * (0.01 + 0.2996 + 0.03), abs=0.02 * STEPS)
    assert float(curve.reward.value[-1]) == pytest.approx(-2.0, abs=1e-3)


def test_the_trend_is_the_parabola_when_the_rewards_are_one(tmp_path: Path) -> None:
    run(tmp_path / "a", 1, lambda part: -3.0 + 4.0 * part - 2.0 * part**2)
    (curve,) = curves([tmp_path / "a"], ["a"])
    part = curve.steps / STEPS
    assert curve.trend == pytest.approx(-3.0 + 4.0 * part - 2.0 * part**2, abs=1e-3)


def test_the_way_begins_at_the_lowest_reward_when_the_first_is_higher(tmp_path: Path) -> None:
    run(tmp_path / "a", 1, lambda part: -1.0 if part <= 0.2 else -5.0 if part <= 0.6 else -2.0)
    (curve,) = curves([tmp_path / "a"], ["a"])
    assert curve.reached_steps is not None
    assert float(curve.reached_steps.value) == pytest.approx(0.65 * STEPS, abs=0.02 * STEPS)


@pytest.mark.parametrize(("first", "lowest"), [(-1e6, -5.0), (-8.0, -8.0)])
def test_a_beginning_far_below_the_rest_leaves_the_picture(
    first: float, lowest: float, tmp_path: Path
) -> None:
    run(tmp_path / "a", 1, lambda part: first if part <= 0.02 else -5.0 + 4.0 * part)
    low, high = draw_curves(curves([tmp_path / "a"], ["a"]), "").axes[0].get_ylim()
    assert lowest - 1.0 < low < lowest + 0.5 and -1.0 < high < 0.0


def test_a_reward_that_falls_reaches_nothing(tmp_path: Path) -> None:
    run(tmp_path / "a", 1, lambda part: -part)
    (curve,) = curves([tmp_path / "a"], ["a"])
    assert curve.reached_steps is None


def test_runs_with_one_label_are_seeds_of_one_configuration(tmp_path: Path) -> None:
    one, two = run(tmp_path / "one", 1, rising(-1.0)), run(tmp_path / "two", 2, rising(-2.0))
    again = run(tmp_path / "again", 1, rising(-1.0))
    other = run(tmp_path / "other", 3, rising(-1.0), config=replace(CONFIG, hidden=(8, 8)))
    (curve,) = curves([one, two], ["ppo", "ppo"])
    assert [each.seed for each in curve.runs] == [1, 2]
    assert [each.label for each in curves([one, two], ["m = 1", "m = 2"])] == ["m = 1", "m = 2"]
    with pytest.raises(TrainingError, match=r"ppo: seeds \[1, 1\]"):
        curves([one, again], ["ppo", "ppo"])
    with pytest.raises(TrainingError, match="differ in hidden, expected the same configuration"):
        curves([one, other], ["ppo", "ppo"])


def test_the_command_prints_and_draws_a_panel_a_configuration(tmp_path: Path, capsys: Capture) -> None:
    for seed in (1, 2):
        run(tmp_path / "ppo" / f"seed-{seed}", seed, rising(-float(seed)))
    run(tmp_path / "ddpg", 1, rising(-1.0))
    plot = tmp_path / "curves.png"
    words = ["policy", "curves", str(tmp_path / "ppo"), str(tmp_path / "ddpg"), "--label", "PPO m=1", "DDPG"]
    assert main([*words, "--json", "--plot", str(plot)]) == 0
    document = json.loads(capsys.readouterr().out)
    first, second = document["curves"]
    assert (first["label"], first["seeds"], second["seeds"]) == ("PPO m=1", [1, 2], [1])
    assert first["final"]["value"] == pytest.approx(-1.5, abs=1e-3)
    assert first["final_episode"]["value"] == 1000 * first["final"]["value"]
    assert [each["final"] for each in first["runs"]] == pytest.approx([-1.0, -2.0], abs=1e-3)
    assert document["command"] == "neuroflight policy curves ppo ddpg --label 'PPO m=1' DDPG"
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--episodes", "--each-seed", "--plot", str(plot)]) == 0
    table = capsys.readouterr().out
    assert "-1,500.2" in table and "DDPG" in table


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["OLD"], "rewards.csv does not exist"),
        (["NONE"], "training.json: cannot be read"),
        (["SHORT"], "has 3 points, expected at least 5"),
        (["GOOD", "--label", "a", "b"], "2 names for 1 runs"),
        (["GOOD", "--plot", "curves.pdf"], "ends in .png"),
    ],
)
def test_it_is_refused_in_one_line(words: list[str], message: str, tmp_path: Path, capsys: Capture) -> None:
    run(tmp_path / "GOOD", 1, rising(-1.0))
    run(tmp_path / "SHORT", 1, rising(-1.0), points=3)
    (run(tmp_path / "OLD", 1, rising(-1.0)) / "rewards.csv").unlink()
    named = [str(tmp_path / word) if word.isupper() else word for word in words]
    assert message in refused(capsys, ["policy", "curves", *named])
